// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <vector>

#include "core_perception/causes.h"
#include "core_perception/projection.h"

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

/// Points at the height of the floor. Noise must not spread them over two layers of voxels.
///
///     min_height_m <= height < metric_min_height_m + metric_slope depth
struct FloorBand {
  float camera_height_m = 0.0f;
  float min_height_m = std::numeric_limits<float>::infinity();  ///< infinite: no such points
  float metric_min_height_m = 0.0f, metric_slope = 0.0f;
  int layer = 0;  ///< see FrameVotes::layerOf
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

  /// Voxels of the points of a row, as touch() takes them. Entries outside the row's [first, end)
  /// are stale. Single precision: a point too near to the border of a voxel is left undecided.
  /// @param floor points of the floor, all of which are put into one layer.
  void locate(const PointRow& row, const FloorBand& floor, std::vector<int32_t>* voxels) const;
  /// The same for one point, in double precision; never kUndecided.
  int32_t locatePoint(const Eigen::Vector3d& d_m, double depth_m, const FloorBand& floor) const;
  static constexpr int32_t kNoVoxel = -1;    ///< no point, or one outside the volume
  static constexpr int32_t kUndecided = -2;  ///< to be given to locatePoint
  /// Tally of a voxel that locate() found; marks it touched.
  VoxelTally& touch(int32_t voxel) {
    VoxelTally& tally = tallies_[voxel];
    if (tally.empty()) touched_.push_back(static_cast<uint32_t>(voxel));
    return tally;
  }
  int layers() const { return layers_; }
  /// Layer of a height in the fixed frame.
  int layerOf(double z_m) const;

  const std::vector<uint32_t>& touched() const { return touched_; }
  const VoxelTally& tally(uint32_t touched) const { return tallies_[touched]; }
  VoxelIndex indexOf(uint32_t touched) const;
  /// Tally of a voxel, or nullptr when no point of this frame fell into it.
  const VoxelTally* find(const VoxelIndex& voxel) const;

 private:
  double resolution_m_;
  float cells_per_m_;
  VoxelIndex origin_{0, 0, 0};
  int width_ = 0, layers_ = 0;
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();  ///< camera in cells, from the volume's corner
  std::vector<VoxelTally> tallies_;
  std::vector<uint32_t> touched_;
};

}  // namespace core_perception
