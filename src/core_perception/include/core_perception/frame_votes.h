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

/// Tallies that lie one after the other.
struct Tallies {
  const VoxelTally *first, *last;

  const VoxelTally* begin() const { return first; }
  const VoxelTally* end() const { return last; }
  size_t size() const { return static_cast<size_t>(last - first); }
  const VoxelTally& operator[](size_t i) const { return first[i]; }
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

  /// Voxels of the points of a row, as RowCounter takes them. Entries outside the row's [first,
  /// end) are stale. Single precision: a point too near to the border of a voxel is left undecided.
  /// @param floor points of the floor, all of which are put into one layer.
  void locate(const PointRow& row, const FloorBand& floor, PixelRow<int32_t>* voxels) const;
  /// The same for one point, in double precision; never kUndecided.
  int32_t locatePoint(const Eigen::Vector3d& d_m, double depth_m, const FloorBand& floor) const;
  static constexpr int32_t kNoVoxel = 0;     ///< no point, or one outside the volume
  static constexpr int32_t kUndecided = -1;  ///< to be given to locatePoint

  /// Counts the pixels of a row. While it lives nothing else may be done with the FrameVotes.
  class RowCounter {
   public:
    /// @param most_adds of add() that will be called.
    RowCounter(FrameVotes* votes, size_t most_adds) : votes_(votes) {
      const size_t most_tallies = votes->n_tallies_ + most_adds;
      if (most_tallies > votes->tallies_.size()) votes->tallies_.resize(2 * most_tallies);
      n_tallies_ = votes->n_tallies_;
      numbers_ = votes->numbers_.data();
      tallies_ = votes->tallies_.data();
    }
    ~RowCounter() { votes_->n_tallies_ = n_tallies_; }
    RowCounter(const RowCounter&) = delete;
    RowCounter& operator=(const RowCounter&) = delete;

    /// Counts pixels in a voxel that locate() found. Which of them are new, and which pixels have
    /// none (kNoVoxel has a tally of its own), the processor cannot foresee: nothing branches on
    /// it.
    void add(int32_t voxel, VoteKind kind, uint32_t n_pixels, uint16_t cause) {
      const uint32_t known = numbers_[voxel];
      n_tallies_ += static_cast<uint32_t>(known == 0);
      const uint32_t number = known == 0 ? n_tallies_ : known;
      numbers_[voxel] = number;
      VoxelTally& tally = tallies_[number - 1];
      tally.voxel = voxel;
      tally.n_pixels[kind] += n_pixels;
      tally.cause[kind] = cause;
    }

   private:
    FrameVotes* votes_;
    uint32_t n_tallies_;
    uint32_t* numbers_;
    VoxelTally* tallies_;
  };
  int layers() const { return layers_; }
  /// Layer of a height in the fixed frame.
  int layerOf(double z_m) const;

  /// Of every voxel that was touched, in the order of their first points.
  Tallies tallies() const { return {tallies_.data() + 1, tallies_.data() + n_tallies_}; }
  /// @param voxel not kNoVoxel.
  VoxelIndex indexOf(int32_t voxel) const {
    const int mask = (1 << width_bits_) - 1, cell = voxel - 1;
    return {origin_.x + (cell & mask), origin_.y + (cell >> width_bits_ & mask),
            origin_.z + (cell >> 2 * width_bits_)};
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
    return (((z << width_bits_) + y) << width_bits_) + x + 1;
  }

  double resolution_m_;
  float cells_per_m_;
  VoxelIndex origin_{0, 0, 0};
  int width_bits_ = 0;  ///< the volume is 2^width_bits_ voxels wide and deep
  int layers_ = 0;
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();  ///< camera in cells, from the volume's corner
  std::vector<uint32_t> numbers_;    ///< of a voxel: 1 + index of its tally, 0 for none
  std::vector<VoxelTally> tallies_;  ///< the first is that of kNoVoxel; from n_tallies_ on empty
  uint32_t n_tallies_ = 1;
};

}  // namespace core_perception
