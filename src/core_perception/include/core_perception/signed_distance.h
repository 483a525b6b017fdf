// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

namespace core_perception {

enum class DistanceConvention {
  kBorder,  ///< to the border of the union of unsafe cell squares: crosses zero where safe meets
            ///< unsafe
  kCentre,  ///< to the nearest cell centre of the other side, as [CORE]: jumps from +1 to -1 cell
            ///< at the border
};

/// A grid of decisions, row-major (index = y * width + x).
struct Mask {
  int width = 0, height = 0;
  std::vector<uint8_t> unsafe;  ///< 1 unsafe, 0 safe
  bool outside_unsafe = true;   ///< whether what lies beyond the grid counts as unsafe
};

inline bool operator==(const Mask& a, const Mask& b) {
  return a.width == b.width && a.height == b.height && a.outside_unsafe == b.outside_unsafe &&
         a.unsafe == b.unsafe;
}

/// Exact signed distance at every cell centre [m]:
///
///     h(x) = +min_{y in U} |x - y|  for a safe cell,  -min_{y in S} |x - y|  for an unsafe one
///
/// with U, S the squares (kBorder) or the centres (kCentre) of the unsafe and of the safe cells.
/// Safe ground beyond the grid is never assumed for unsafe cells. Where the other side does not
/// exist, |h| is the diagonal of the grid. Source: [CORE] eq. barrier. Column scans, then for every
/// row the least over all columns, nearest ones first: of higher order than a lower envelope of
/// parabolas (Felzenszwalb and Huttenlocher 2012), but in whole numbers and without branches, and
/// faster for grids of this size.
/// @param mask at most 2^13 cells along an edge.
std::vector<float> computeSignedDistance(const Mask& mask, double resolution_m,
                                         DistanceConvention convention);

}  // namespace core_perception
