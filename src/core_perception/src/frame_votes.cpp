// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/frame_votes.h"

#include <algorithm>
#include <cmath>

namespace core_perception {
namespace {

int floorDivide(double value, double step) { return static_cast<int>(std::floor(value / step)); }

/// More than single precision is wrong by, in cells and in metres: 10 m in steps of 2^-20 m,
/// through a handful of operations.
constexpr float kUncertain = 5e-5f;

/// Distance from the middle between two whole numbers, of which floor is the lower one.
inline float measureFromMiddle(float value, float floor) { return std::abs(value - floor - 0.5f); }

}  // namespace

constexpr int32_t FrameVotes::kNoVoxel;
constexpr int32_t FrameVotes::kUndecided;

FrameVotes::FrameVotes(double resolution_m, double min_z_m, double max_z_m)
    : resolution_m_(resolution_m),
      cells_per_m_(static_cast<float>(1.0 / resolution_m)),
      tallies_(1) {
  origin_.z = floorDivide(min_z_m, resolution_m);
  layers_ = floorDivide(max_z_m, resolution_m) - origin_.z + 1;
}

void FrameVotes::start(const Eigen::Vector3d& p_map_camera, double reach_m) {
  uint32_t* numbers = numbers_.data();
  for (const VoxelTally& tally : tallies()) numbers[tally.voxel] = 0;
  static const VoxelTally kNothing;  // not on the stack, from which it would be read back each time
  std::fill_n(tallies_.data(), n_tallies_, kNothing);
  n_tallies_ = 1;
  const int reach = static_cast<int>(std::ceil(reach_m / resolution_m_)) + 1;
  // A power of two: indices come and go without a division.
  for (width_bits_ = 0; 1 << width_bits_ < 2 * reach + 1;) ++width_bits_;
  origin_.x = floorDivide(p_map_camera.x(), resolution_m_) - reach;
  origin_.y = floorDivide(p_map_camera.y(), resolution_m_) - reach;
  for (int axis = 0; axis < 3; ++axis) {
    const int origin = axis == 0 ? origin_.x : axis == 1 ? origin_.y : origin_.z;
    offset_[axis] = p_map_camera[axis] / resolution_m_ - origin;
  }
  const size_t size = (static_cast<size_t>(layers_) << 2 * width_bits_) + 1;
  if (numbers_.size() < size) numbers_.resize(size);
  numbers_[kNoVoxel] = 1;
}

void FrameVotes::locate(const PointRow& row, const FloorBand& floor,
                        PixelRow<int32_t>* voxels) const {
  voxels->resize(row.depth_m.size());
  const int begin = blockBegin(row.first);
  const int n = blockEnd(row.end) - begin;
  int32_t* result = voxels->data() + begin;
  const float *depth = row.depth_m.data() + begin, *dx = row.dx_m.data() + begin,
              *dy = row.dy_m.data() + begin, *dz = row.dz_m.data() + begin;
  const float scale = cells_per_m_, x0 = static_cast<float>(offset_.x()),
              y0 = static_cast<float>(offset_.y()), z0 = static_cast<float>(offset_.z());
  const int bits = width_bits_, layers = layers_, floor_layer = floor.layer;
  const unsigned width = 1u << bits;
  const float camera_height = floor.camera_height_m, floor_min = floor.min_height_m,
              metric_min = floor.metric_min_height_m, slope = floor.metric_slope;
  // Written as one choice after the other: that is what compilers make vector instructions of.
  for (int i = 0; i < n; ++i) {
    const float cell_x = x0 + dx[i] * scale, cell_y = y0 + dy[i] * scale;
    const float cell_z = z0 + dz[i] * scale;
    const float low_x = std::floor(cell_x), low_y = std::floor(cell_y), low_z = std::floor(cell_z);
    const float height = camera_height + dz[i], floor_top = metric_min + slope * depth[i];
    const bool is_floor = (height < floor_top) & (height >= floor_min);
    const int x = static_cast<int>(low_x), y = static_cast<int>(low_y);
    const int z = is_floor ? floor_layer : static_cast<int>(low_z);
    const float off_middle =
        std::max(measureFromMiddle(cell_z, low_z),
                 std::max(measureFromMiddle(cell_x, low_x), measureFromMiddle(cell_y, low_y)));
    const float off_floor = std::min(std::abs(height - floor_top), std::abs(height - floor_min));
    const bool is_undecided = (off_middle > 0.5f - kUncertain) | (off_floor < kUncertain);
    // As unsigned a negative index is a large one.
    const auto xy = static_cast<unsigned>(x) | static_cast<unsigned>(y);
    const bool is_inside =
        (xy < width) & (static_cast<unsigned>(z) < static_cast<unsigned>(layers));
    const auto rows = (static_cast<unsigned>(z) << bits) + static_cast<unsigned>(y);
    int voxel = static_cast<int>((rows << bits) + static_cast<unsigned>(x) + 1u);
    voxel = is_inside ? voxel : kNoVoxel;
    voxel = is_undecided ? kUndecided : voxel;
    result[i] = depth[i] > 0.0f ? voxel : kNoVoxel;
  }
}

int32_t FrameVotes::locatePoint(const Eigen::Vector3d& d_m, double depth_m,
                                const FloorBand& floor) const {
  const Eigen::Vector3d cell = offset_ + d_m / resolution_m_;
  const int x = static_cast<int>(std::floor(cell.x())), y = static_cast<int>(std::floor(cell.y()));
  const double height_m = floor.camera_height_m + d_m.z();
  const bool is_floor = height_m >= floor.min_height_m &&
                        height_m < floor.metric_min_height_m + floor.metric_slope * depth_m;
  const int z = is_floor ? floor.layer : static_cast<int>(std::floor(cell.z()));
  return isInside(x, y, z) ? indexOfCell(x, y, z) : kNoVoxel;
}

int FrameVotes::layerOf(double z_m) const { return floorDivide(z_m, resolution_m_) - origin_.z; }

const VoxelTally* FrameVotes::find(const VoxelIndex& voxel) const {
  const int x = voxel.x - origin_.x, y = voxel.y - origin_.y, z = voxel.z - origin_.z;
  if (!isInside(x, y, z)) return nullptr;
  const uint32_t number = numbers_[indexOfCell(x, y, z)];
  return number == 0 ? nullptr : &tallies_[number - 1];
}

}  // namespace core_perception
