// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core_perception/causes.h"

namespace core_perception {

/// Index of a voxel of the fixed frame: floor(coordinate / resolution).
struct VoxelIndex {
  int x, y, z;
};

/// What one frame saw of one voxel.
struct VoxelTally {
  uint32_t n_safe = 0;    ///< pixels
  uint32_t n_unsafe = 0;  ///< pixels, those of the metric band not among them
  uint16_t n_metric = 0;  ///< pixels in the metric band; stops at 65535
  uint16_t cause = kNoCause;
  uint16_t metric_cause = kNoCause;
  bool empty() const { return n_safe == 0 && n_unsafe == 0 && n_metric == 0; }
};

/// Dense scratch volume around the camera in which the pixels of one frame are counted, with a list
/// of touched voxels. It spans the whole reach of the camera: a point outside can only lie above or
/// below the 3-D map.
class FrameVotes {
 public:
  /// @param min_z_m, max_z_m span of the 3-D map in the fixed frame.
  FrameVotes(double resolution_m, double min_z_m, double max_z_m);

  /// Empties it and moves it around a camera of this reach.
  void start(const Eigen::Vector3d& p_map_camera, double reach_m);

  /// Tally of the voxel of a point given relative to the camera, or nullptr when that lies outside.
  /// Marks it touched.
  VoxelTally* touch(float dx_m, float dy_m, float dz_m) {
    const int x = floorIndex(offset_.x() + dx_m * cells_per_m_);
    const int y = floorIndex(offset_.y() + dy_m * cells_per_m_);
    return touchIndex(x, y, floorIndex(offset_.z() + dz_m * cells_per_m_));
  }
  /// The same with the height given as layer, see layerOf.
  VoxelTally* touchLayer(float dx_m, float dy_m, int layer) {
    const int x = floorIndex(offset_.x() + dx_m * cells_per_m_);
    return touchIndex(x, floorIndex(offset_.y() + dy_m * cells_per_m_), layer);
  }
  /// Layer of a height in the fixed frame.
  int layerOf(double z_m) const;

  const std::vector<uint32_t>& touched() const { return touched_; }
  const VoxelTally& tally(uint32_t touched) const { return tallies_[touched]; }
  VoxelIndex indexOf(uint32_t touched) const;
  /// Tally of a voxel, or nullptr when no point of this frame fell into it.
  const VoxelTally* find(const VoxelIndex& voxel) const;

 private:
  static int floorIndex(float value) {
    const int truncated = static_cast<int>(value);
    return truncated - (value < static_cast<float>(truncated) ? 1 : 0);
  }
  VoxelTally* touchIndex(int x, int y, int z);

  double resolution_m_;
  float cells_per_m_;
  VoxelIndex origin_{0, 0, 0};
  int width_ = 0, layers_ = 0;
  Eigen::Vector3f offset_ = Eigen::Vector3f::Zero();  ///< camera in cells, from the volume's corner
  std::vector<VoxelTally> tallies_;
  std::vector<uint32_t> touched_;
};

inline VoxelTally* FrameVotes::touchIndex(int x, int y, int z) {
  // One unsigned comparison each also refuses negative indices.
  if (static_cast<unsigned>(x) >= static_cast<unsigned>(width_) ||
      static_cast<unsigned>(y) >= static_cast<unsigned>(width_) ||
      static_cast<unsigned>(z) >= static_cast<unsigned>(layers_)) {
    return nullptr;
  }
  const auto index = static_cast<uint32_t>((y * width_ + x) * layers_ + z);
  VoxelTally* tally = &tallies_[index];
  if (tally->empty()) touched_.push_back(index);
  return tally;
}

}  // namespace core_perception
