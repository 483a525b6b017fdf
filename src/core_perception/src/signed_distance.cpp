// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/signed_distance.h"

#include <algorithm>
#include <cmath>

namespace core_perception {
namespace {

/// Squared distances are whole numbers in units of half a cell: exact, and quick to compare.
constexpr int32_t kFar = 1 << 29;

/// Square of the distance between the centres of two cells n rows or columns apart, or from a
/// centre to the nearer edge of the other cell [half cells squared].
int32_t squareReach(int32_t n, DistanceConvention convention) {
  const int32_t reach = convention == DistanceConvention::kBorder ? std::max(0, 2 * n - 1) : 2 * n;
  return reach * reach;
}

/// Squared distance to the nearest cell of this value in the same column; kFar where there is none.
std::vector<int32_t> scanColumns(const Mask& mask, uint8_t target, DistanceConvention convention) {
  const size_t w = mask.width, n = mask.unsafe.size();
  std::vector<int32_t> steps(n);
  for (size_t i = 0; i < n; ++i)
    steps[i] = mask.unsafe[i] == target ? 0 : i < w ? kFar : std::min(kFar, steps[i - w] + 1);
  for (size_t i = n - w; i-- > 0;) steps[i] = std::min(steps[i], steps[i + w] + 1);
  for (int32_t& step : steps) step = step >= mask.height ? kFar : squareReach(step, convention);
  return steps;
}

/// Largest of n numbers >= 0.
int32_t findLargest(const int32_t* values, int n) {
  int32_t largest = 0;
  for (int i = 0; i < n; ++i) largest = std::max(largest, values[i]);
  return largest;
}

/// best[i] = min(best[i], cost[i] + more).
void lower(const int32_t* cost, int32_t more, int n, int32_t* best) {
  for (int i = 0; i < n; ++i) best[i] = std::min(best[i], cost[i] + more);
}

/// Squared distance from every centre to the nearest square or centre of a cell of this value [half
/// cells squared]; >= kFar where there is none.
std::vector<int32_t> transform(const Mask& mask, uint8_t target, DistanceConvention convention) {
  const int w = mask.width;
  const std::vector<int32_t> column = scanColumns(mask, target, convention);
  std::vector<int32_t> result = column;
  for (int y = 0; y < mask.height; ++y) {
    const int32_t* cost = &column[static_cast<size_t>(y) * w];
    int32_t* best = &result[static_cast<size_t>(y) * w];
    // Cells d columns away, as long as the nearest of them could still be nearer for somebody.
    for (int d = 1; d < w; ++d) {
      const int32_t more = squareReach(d, convention);
      if (more >= findLargest(best, w)) break;
      lower(cost, more, w - d, best + d);
      lower(cost + d, more, w - d, best);
    }
  }
  return result;
}

/// Distance in cells from a centre to what lies beyond the grid.
double measureToOutside(const Mask& mask, int x, int y, DistanceConvention convention) {
  const int nearest = std::min(std::min(x, mask.width - 1 - x), std::min(y, mask.height - 1 - y));
  return nearest + (convention == DistanceConvention::kBorder ? 0.5 : 1.0);
}

}  // namespace

std::vector<float> computeSignedDistance(const Mask& mask, double resolution_m,
                                         DistanceConvention convention) {
  const std::vector<int32_t> to_unsafe = transform(mask, 1, convention);
  const std::vector<int32_t> to_safe = transform(mask, 0, convention);
  const double diagonal = std::hypot(mask.width, mask.height);
  std::vector<float> h(mask.unsafe.size());
  for (int y = 0; y < mask.height; ++y) {
    for (int x = 0; x < mask.width; ++x) {
      const size_t i = static_cast<size_t>(y) * mask.width + x;
      const bool unsafe = mask.unsafe[i] != 0;
      double cells = std::min(diagonal, 0.5 * std::sqrt(unsafe ? to_safe[i] : to_unsafe[i]));
      if (!unsafe && mask.outside_unsafe)
        cells = std::min(cells, measureToOutside(mask, x, y, convention));
      h[i] = static_cast<float>((unsafe ? -cells : cells) * resolution_m);
    }
  }
  return h;
}

}  // namespace core_perception
