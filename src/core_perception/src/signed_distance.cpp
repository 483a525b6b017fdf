// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/signed_distance.h"

#include <algorithm>
#include <cmath>

namespace core_perception {
namespace {

/// Squared distances are whole numbers in units of half a cell: exact, and quick to compare.
constexpr int32_t kFar = 1 << 29;

/// Cells of a row that are worked on together; up to 16 a compiler would take them one by one.
constexpr int kBlock = 32;

/// Square of the distance between the centres of two cells n rows or columns apart, or from a
/// centre to the nearer edge of the other cell [half cells squared].
int32_t squareReach(int32_t n, DistanceConvention convention) {
  const int32_t reach = convention == DistanceConvention::kBorder ? std::max(0, 2 * n - 1) : 2 * n;
  return reach * reach;
}

/// Squared distances in the same column to the nearest cell of this value; kFar where there is
/// none.
std::vector<int32_t> scanColumns(const Mask& mask, uint8_t target, DistanceConvention convention) {
  const int w = mask.width, h = mask.height;
  std::vector<int32_t> steps(mask.unsafe.size());
  const auto scan = [&](int y, int from) {
    const uint8_t* value = &mask.unsafe[static_cast<size_t>(y) * w];
    const int32_t* before = &steps[static_cast<size_t>(from) * w];
    int32_t* step = &steps[static_cast<size_t>(y) * w];
    for (int x = 0; x < w; ++x) step[x] = value[x] == target ? 0 : std::min(step[x], before[x] + 1);
  };
  std::fill(steps.begin(), steps.end(), kFar);
  for (int y = 0; y < h; ++y) scan(y, std::max(y - 1, 0));
  for (int y = h - 2; y >= 0; --y) scan(y, y + 1);
  for (int32_t& step : steps) {
    const int32_t reach =
        convention == DistanceConvention::kBorder ? std::max(0, 2 * step - 1) : 2 * step;
    step = step >= h ? kFar : reach * reach;
  }
  return steps;
}

/// The same over all columns for the cells [first, first + kBlock) of a row. Cells d columns away
/// are looked at as long as the nearest of them could still be nearer for somebody.
/// @param cost squares of the row from `first` on; kFar for `width` beyond both ends of it.
void scanBlock(const int32_t* cost, int width, DistanceConvention convention, int32_t* best) {
  int32_t block[kBlock];  // of its own, so that the compiler can hold it in registers
  std::copy(best, best + kBlock, block);
  int32_t largest = kFar;
  for (int d = 1, look = 1; d < width; ++d) {
    if (d == look) {  // not every time: it takes longer than the columns
      largest = 0;
      for (int i = 0; i < kBlock; ++i) largest = std::max(largest, block[i]);
      look *= 2;
    }
    const int32_t more = squareReach(d, convention);
    if (more >= largest) break;
    for (int i = 0; i < kBlock; ++i)
      block[i] = std::min(block[i], std::min(cost[i - d], cost[i + d]) + more);
  }
  std::copy(block, block + kBlock, best);
}

/// Lowers `nearest`, squared distances from every centre, to those to the nearest square or centre
/// of a cell of this value [half cells squared].
void transform(const Mask& mask, uint8_t target, DistanceConvention convention,
               std::vector<int32_t>* nearest) {
  const int w = mask.width, margin = w + kBlock;
  const std::vector<int32_t> columns = scanColumns(mask, target, convention);
  std::vector<int32_t> cost(static_cast<size_t>(w + 2 * margin), kFar);
  for (int y = 0; y < mask.height; ++y) {
    const int32_t* row = &columns[static_cast<size_t>(y) * w];
    std::copy(row, row + w, cost.begin() + margin);
    for (int first = 0; first < w; first += kBlock) {
      const int n = std::min(kBlock, w - first);
      int32_t* result = &(*nearest)[static_cast<size_t>(y) * w + first];
      int32_t best[kBlock] = {};  // beyond the end nobody waits for anything
      for (int i = 0; i < n; ++i) best[i] = std::min(result[i], row[first + i]);
      scanBlock(&cost[margin + first], w, convention, best);
      std::copy(best, best + n, result);
    }
  }
}

/// Squared distance from the centres of the safe cells to what lies beyond the grid [half cells
/// squared]; kFar where that does not count.
std::vector<int32_t> measureToOutside(const Mask& mask, DistanceConvention convention) {
  std::vector<int32_t> nearest(mask.unsafe.size(), kFar);
  const int w = mask.width, h = mask.height;
  for (int y = 0; y < h && mask.outside_unsafe; ++y) {
    for (int x = 0; x < w; ++x) {
      const int cells = 1 + std::min(std::min(x, w - 1 - x), std::min(y, h - 1 - y));
      nearest[static_cast<size_t>(y) * w + x] = squareReach(cells, convention);
    }
  }
  return nearest;
}

}  // namespace

std::vector<float> computeSignedDistance(const Mask& mask, double resolution_m,
                                         DistanceConvention convention) {
  std::vector<int32_t> to_unsafe = measureToOutside(mask, convention);
  std::vector<int32_t> to_safe(mask.unsafe.size(), kFar);
  transform(mask, 1, convention, &to_unsafe);
  transform(mask, 0, convention, &to_safe);
  const double diagonal = std::hypot(mask.width, mask.height);
  std::vector<float> h(mask.unsafe.size());
  for (size_t i = 0; i < h.size(); ++i) {
    // The other one is 0.
    const double cells = std::min(diagonal, 0.5 * std::sqrt(to_safe[i] + to_unsafe[i]));
    h[i] = static_cast<float>((mask.unsafe[i] != 0 ? -cells : cells) * resolution_m);
  }
  return h;
}

}  // namespace core_perception
