// SPDX-License-Identifier: BSD-3-Clause
#include "reference_map.h"

#include <cmath>
#include <stdexcept>

#include "image_masks.h"

namespace core_perception {
namespace bench {
namespace {

uint64_t distance(uint64_t a, uint64_t b) { return a > b ? a - b : b - a; }

/// Number of voxels along each edge of a leaf: more than one where it was pruned.
int countEdge(unsigned leaf_depth, unsigned tree_depth) { return 1 << (tree_depth - leaf_depth); }

}  // namespace

ReferenceMap::ReferenceMap(const SemanticMapParams& params) : params_(params) {
  const VoteParams& vote = params.vote;
  if (!params.usesImageOperators() || !params.semantics || vote.votes != "pixel" ||
      vote.column != "sum" || vote.count_cap != 0 || vote.metric_layer ||
      vote.free_space_clearing || params.range.depth_edge_ratio != 0.0) {
    throw std::runtime_error("the reference is that of profile paper");
  }
}

void ReferenceMap::update(const Frame& frame, const std::vector<Predicate>& predicates) {
  if (!started_) first_ = frame.p_map_base;
  started_ = true;
  const cv::Mat safe = drawSafeMask(frame, predicates, params_.kernel_px);
  const RangeParams& range = params_.range;
  const Camera& camera = frame.camera;
  const double cell_m = params_.resolution_m;
  const double tree_min = std::floor((range.floor_z_m + range.tree_min_z_m) / cell_m);
  const double tree_max = std::floor((range.floor_z_m + range.tree_max_z_m) / cell_m);
  for (int v = 0; v < frame.depth.rows; ++v) {
    for (int u = 0; u < frame.depth.cols; ++u) {
      const double z = frame.depth.at<uint16_t>(v, u) / 1000.0;
      if (z == 0.0 || z < range.range_min_m || z > range.range_max_m) continue;
      const Eigen::Vector3d ray((u - camera.cx_px) / camera.fx_px,
                                (v - camera.cy_px) / camera.fy_px, 1.0);
      const Eigen::Vector3d p = frame.T_map_camera * (ray * z);
      const Voxel voxel = {static_cast<int>(std::floor(p.x() / cell_m)),
                           static_cast<int>(std::floor(p.y() / cell_m)),
                           static_cast<int>(std::floor(p.z() / cell_m))};
      if (voxel[2] < tree_min || voxel[2] > tree_max) continue;
      ++observations_;
      const bool is_safe = safe.at<uint8_t>(v, u) != 0;
      Votes& votes = voxels_[voxel];
      ++(is_safe ? votes.n_safe : votes.n_unsafe);
      // The band takes every voxel that shares more than a face with it.
      const double low = voxel[2] * cell_m, high = low + cell_m, tiny = 1e-9;
      if (high <= range.floor_z_m + range.band_min_z_m + tiny) continue;
      if (low >= range.floor_z_m + range.band_max_z_m - tiny) continue;
      Votes& column = columns_[{voxel[0], voxel[1]}];
      ++(is_safe ? column.n_safe : column.n_unsafe);
    }
  }
}

CellState ReferenceMap::decide(int x, int y) const {
  const auto it = columns_.find({x, y});
  if (it == columns_.end()) {
    const double dx = (x + 0.5) * params_.resolution_m - first_.x;
    const double dy = (y + 0.5) * params_.resolution_m - first_.y;
    return std::hypot(dx, dy) <= params_.initial_disc_radius_m ? CellState::kSafe
                                                               : CellState::kUnknown;
  }
  const auto n_safe = static_cast<double>(it->second.n_safe);
  const auto n_unsafe = static_cast<double>(it->second.n_unsafe);
  return n_safe / (n_safe + n_unsafe) >= params_.vote.tau ? CellState::kSafe : CellState::kUnsafe;
}

uint64_t ReferenceMap::countDifferent(const SafetyGrid& grid, uint64_t* compared) const {
  uint64_t different = 0;
  for (int y = 0; y < grid.frame.height; ++y) {
    for (int x = 0; x < grid.frame.width; ++x) {
      const CellState got = grid.state[static_cast<size_t>(y) * grid.frame.width + x];
      const CellState due = decide(grid.frame.origin.x + x, grid.frame.origin.y + y);
      if (got == CellState::kUnknown && due == CellState::kUnknown) continue;
      ++*compared;
      if (got != due) ++different;
    }
  }
  return different;
}

uint64_t ReferenceMap::countDifferent(const SemanticOcTree& tree) const {
  std::map<Voxel, Votes> left = voxels_;
  uint64_t moved = 0;
  for (auto it = tree.begin_leafs(), end = tree.end_leafs(); it != end; ++it) {
    const octomap::OcTreeKey corner = it.getIndexKey();
    const int edge = countEdge(it.getDepth(), tree.getTreeDepth());
    for (int i = 0; i < edge * edge * edge; ++i) {
      const Voxel voxel = {corner[0] + i % edge - 32768, corner[1] + i / edge % edge - 32768,
                           corner[2] + i / (edge * edge) - 32768};
      Votes due;
      const auto found = left.find(voxel);
      if (found != left.end()) {
        due = found->second;
        left.erase(found);
      }
      moved += distance(it->n_safe(), due.n_safe) + distance(it->n_unsafe(), due.n_unsafe);
    }
  }
  for (const auto& rest : left) moved += rest.second.n_safe + rest.second.n_unsafe;
  return (moved + 1) / 2;  // one that moved is missing in one place and too much in another
}

uint64_t sumLeafCounts(const SemanticOcTree& tree) {
  uint64_t sum = 0;
  for (auto it = tree.begin_leafs(), end = tree.end_leafs(); it != end; ++it) {
    const auto edge = static_cast<uint64_t>(countEdge(it.getDepth(), tree.getTreeDepth()));
    sum += edge * edge * edge * (static_cast<uint64_t>(it->n_safe()) + it->n_unsafe());
  }
  return sum;
}

}  // namespace bench
}  // namespace core_perception
