// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/frame_votes.h"

#include <cmath>

namespace core_perception {
namespace {

int floorDivide(double value, double step) { return static_cast<int>(std::floor(value / step)); }

}  // namespace

FrameVotes::FrameVotes(double resolution_m, double min_z_m, double max_z_m)
    : resolution_m_(resolution_m), cells_per_m_(static_cast<float>(1.0 / resolution_m)) {
  origin_.z = floorDivide(min_z_m, resolution_m);
  layers_ = floorDivide(max_z_m, resolution_m) - origin_.z + 1;
}

void FrameVotes::start(const Eigen::Vector3d& p_map_camera, double reach_m) {
  for (const uint32_t index : touched_) tallies_[index] = VoxelTally();
  touched_.clear();
  const int reach = static_cast<int>(std::ceil(reach_m / resolution_m_)) + 1;
  width_ = 2 * reach + 1;
  origin_.x = floorDivide(p_map_camera.x(), resolution_m_) - reach;
  origin_.y = floorDivide(p_map_camera.y(), resolution_m_) - reach;
  for (int axis = 0; axis < 3; ++axis) {
    const int origin = axis == 0 ? origin_.x : axis == 1 ? origin_.y : origin_.z;
    offset_[axis] = static_cast<float>(p_map_camera[axis] / resolution_m_ - origin);
  }
  const size_t size = static_cast<size_t>(width_) * width_ * layers_;
  if (tallies_.size() < size) tallies_.resize(size);
}

int FrameVotes::layerOf(double z_m) const { return floorDivide(z_m, resolution_m_) - origin_.z; }

VoxelIndex FrameVotes::indexOf(uint32_t touched) const {
  const int column = static_cast<int>(touched) / layers_;
  return {origin_.x + column % width_, origin_.y + column / width_,
          origin_.z + static_cast<int>(touched) % layers_};
}

const VoxelTally* FrameVotes::find(const VoxelIndex& voxel) const {
  const int x = voxel.x - origin_.x, y = voxel.y - origin_.y, z = voxel.z - origin_.z;
  if (x < 0 || y < 0 || z < 0 || x >= width_ || y >= width_ || z >= layers_) return nullptr;
  const VoxelTally& tally = tallies_[(static_cast<size_t>(y) * width_ + x) * layers_ + z];
  return tally.empty() ? nullptr : &tally;
}

}  // namespace core_perception
