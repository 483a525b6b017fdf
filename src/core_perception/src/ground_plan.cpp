// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/ground_plan.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>

namespace core_perception {
namespace {

constexpr int kKeyOffset = SemanticOcTree::kKeyOffset;

/// Indices of cells, both included.
struct Extent {
  int x_min = std::numeric_limits<int>::max(), y_min = x_min;
  int x_max = std::numeric_limits<int>::min(), y_max = x_max;

  bool empty() const { return x_max < x_min; }
  void add(int x, int y) {
    x_min = std::min(x_min, x);
    y_min = std::min(y_min, y);
    x_max = std::max(x_max, x);
    y_max = std::max(y_max, y);
  }
};

/// A leaf in indices of the map: its lowest cell, and how many layers of it lie in the band.
struct BandLeaf {
  int x, y, edge, n_layers;
  Counts counts;
};

void forEachInBand(const TreeSnapshot& snapshot, const HeightBand& band,
                   const std::function<void(const BandLeaf&)>& visit) {
  forEachLeaf(snapshot, [&](const SnapshotLeaf& leaf) {
    const int z = leaf.lowest[2] - kKeyOffset;
    const int n_layers = std::min(z + leaf.edge() - 1, band.highest) - std::max(z, band.lowest) + 1;
    if (n_layers <= 0 || leaf.counts.empty()) return;
    visit(BandLeaf{leaf.lowest[0] - kKeyOffset, leaf.lowest[1] - kKeyOffset, leaf.edge(), n_layers,
                   leaf.counts});
  });
}

GridFrame findFrame(const TreeSnapshot& snapshot, const HeightBand& band,
                    const std::vector<Region>& regions) {
  Extent extent;
  forEachInBand(snapshot, band, [&extent](const BandLeaf& leaf) {
    extent.add(leaf.x, leaf.y);
    extent.add(leaf.x + leaf.edge - 1, leaf.y + leaf.edge - 1);
  });
  GridFrame frame;
  frame.resolution_m = snapshot.resolution_m;
  if (extent.empty()) return frame;
  const auto toIndex = [&frame](double coordinate_m) {
    // Clamped before it becomes an integer: a radius may reach farther than an integer can say.
    const double cell = std::floor(coordinate_m / frame.resolution_m);
    return static_cast<int>(std::min(std::max(cell, -1e6), 1e6));
  };
  for (const Region& region : regions) {
    for (const Polygon& part : region.parts) {
      for (const Point2& corner : part) {
        extent.add(toIndex(corner.x - region.radius_m), toIndex(corner.y - region.radius_m));
        extent.add(toIndex(corner.x + region.radius_m), toIndex(corner.y + region.radius_m));
      }
    }
  }
  constexpr int64_t kMostCells = 16000000;
  const int64_t width = static_cast<int64_t>(extent.x_max) - extent.x_min + 1;
  const int64_t height = static_cast<int64_t>(extent.y_max) - extent.y_min + 1;
  if (width * height > kMostCells)
    throw std::length_error("a map of " + std::to_string(width) + "x" + std::to_string(height) +
                            " cells is too large to be sent whole");
  frame.origin = CellIndex{extent.x_min, extent.y_min};
  frame.width = static_cast<int>(width);
  frame.height = static_cast<int>(height);
  return frame;
}

void addLeaf(const BandLeaf& leaf, bool sum, const GridFrame& frame, std::vector<Counts>* columns) {
  for (int y = leaf.y; y < leaf.y + leaf.edge; ++y) {
    for (int x = leaf.x; x < leaf.x + leaf.edge; ++x) {
      const size_t i = static_cast<size_t>(y - frame.origin.y) * frame.width + (x - frame.origin.x);
      for (int k = 0; k < leaf.n_layers; ++k) joinColumn(leaf.counts, sum, &(*columns)[i]);
    }
  }
}

}  // namespace

GroundPlan projectToGround(const TreeSnapshot& snapshot, const HeightBand& band,
                           const VoteParams& params, const std::vector<Region>& regions) {
  GroundPlan plan;
  plan.frame = findFrame(snapshot, band, regions);
  const size_t n = static_cast<size_t>(plan.frame.width) * plan.frame.height;
  std::vector<Counts> columns(n);
  const bool sum = params.column == "sum";
  forEachInBand(snapshot, band,
                [&](const BandLeaf& leaf) { addLeaf(leaf, sum, plan.frame, &columns); });
  plan.cells.assign(n, -1);
  for (size_t i = 0; i < n; ++i) {
    if (!columns[i].empty()) plan.cells[i] = isSafe(columns[i], params.tau) ? 0 : 100;
  }
  if (n == 0) return plan;
  for (const Region& region : regions) {
    if (!region.slow) forEachCell(region, plan.frame, [&plan](size_t i) { plan.cells[i] = 100; });
  }
  return plan;
}

}  // namespace core_perception
