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

/// What a pixel says of the voxel of its point.
enum VoteKind {
  kSafeVote,
  kUnsafeVote,
  kMetricVote,  ///< an obstacle, whatever the predicates say: it lies in the metric band
};
constexpr int kVoteKinds = 3;

/// What one frame saw of one voxel.
struct VoxelTally {
  int32_t voxel = 0;                                            ///< as FrameVotes::locate says it
  uint32_t n_pixels[kVoteKinds] = {};                           ///< by VoteKind
  uint16_t cause[kVoteKinds] = {kNoCause, kNoCause, kNoCause};  ///< of the newest of each kind

  uint32_t n_safe() const { return n_pixels[kSafeVote]; }
  uint32_t n_unsafe() const { return n_pixels[kUnsafeVote]; }
  uint32_t n_metric() const { return n_pixels[kMetricVote]; }
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

/// Scratch volume around the camera in which the pixels of one frame are counted: for every voxel
/// the number of its tally, and the tallies of those that were touched, close together in memory.
/// It spans the whole reach of the camera: a point outside can only lie above or below the 3-D map.
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
  /// Tally of a voxel that locate() found. The next call may move it.
  VoxelTally& touch(int32_t voxel) {
    uint32_t& number = numbers_[voxel];
    if (number == 0) {
      tallies_.emplace_back();
      tallies_.back().voxel = voxel;
      number = static_cast<uint32_t>(tallies_.size());
    }
    return tallies_[number - 1];
  }
  /// Counts pixels in a voxel that locate() found; kNoVoxel: nowhere.
  void add(int32_t voxel, VoteKind kind, uint32_t n_pixels, uint16_t cause) {
    if (voxel == kNoVoxel) return;
    VoxelTally& tally = touch(voxel);
    tally.n_pixels[kind] += n_pixels;
    tally.cause[kind] = cause;
  }
  int layers() const { return layers_; }
  /// Layer of a height in the fixed frame.
  int layerOf(double z_m) const;

  /// Of every voxel that was touched, in the order of their first points.
  const std::vector<VoxelTally>& tallies() const { return tallies_; }
  VoxelIndex indexOf(int32_t voxel) const {
    const int mask = (1 << width_bits_) - 1;
    return {origin_.x + (voxel & mask), origin_.y + (voxel >> width_bits_ & mask),
            origin_.z + (voxel >> 2 * width_bits_)};
  }
  /// Tally of a voxel, or nullptr when no point of this frame fell into it.
  const VoxelTally* find(const VoxelIndex& voxel) const;

 private:
  bool isInside(int x, int y, int z) const {
    const int width = 1 << width_bits_;
    return x >= 0 && y >= 0 && z >= 0 && x < width && y < width && z < layers_;
  }
  /// x, y, z from the volume's corner.
  int32_t indexOfCell(int x, int y, int z) const {
    return (((z << width_bits_) + y) << width_bits_) + x;
  }

  double resolution_m_;
  float cells_per_m_;
  VoxelIndex origin_{0, 0, 0};
  int width_bits_ = 0;  ///< the volume is 2^width_bits_ voxels wide and deep
  int layers_ = 0;
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();  ///< camera in cells, from the volume's corner
  std::vector<uint32_t> numbers_;  ///< of a voxel: 1 + index of its tally, 0 for none
  std::vector<VoxelTally> tallies_;
};

}  // namespace core_perception
