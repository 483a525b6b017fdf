// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/frame_votes.h"

#include <algorithm>
#include <cmath>

namespace core_perception {
namespace {

int floorDivide(double value, double step) { return static_cast<int>(std::floor(value / step)); }

/// floor() of a value that fits an int; a comparison instead of a call, so that loops over it
/// become vector instructions.
inline int floorIndex(float value) {
  const int truncated = static_cast<int>(value);
  return truncated - static_cast<int>(value < static_cast<float>(truncated));
}

/// More than single precision is wrong by, in cells and in metres: 10 m in steps of 2^-20 m,
/// through a handful of operations.
constexpr float kUncertain = 5e-5f;

/// Distance to the next whole number.
inline float measureToBorder(float value, int floor) {
  const float part = value - static_cast<float>(floor);
  return std::min(part, 1.0f - part);
}

}  // namespace

constexpr int32_t FrameVotes::kNoVoxel;
constexpr int32_t FrameVotes::kUndecided;

FrameVotes::FrameVotes(double resolution_m, double min_z_m, double max_z_m)
    : resolution_m_(resolution_m), cells_per_m_(static_cast<float>(1.0 / resolution_m)) {
  origin_.z = floorDivide(min_z_m, resolution_m);
  layers_ = floorDivide(max_z_m, resolution_m) - origin_.z + 1;
}

void FrameVotes::start(const Eigen::Vector3d& p_map_camera, double reach_m) {
  for (const VoxelTally& tally : tallies_) numbers_[tally.voxel] = 0;
  tallies_.clear();
  const int reach = static_cast<int>(std::ceil(reach_m / resolution_m_)) + 1;
  // A power of two: indices come and go without a division.
  for (width_bits_ = 0; 1 << width_bits_ < 2 * reach + 1;) ++width_bits_;
  origin_.x = floorDivide(p_map_camera.x(), resolution_m_) - reach;
  origin_.y = floorDivide(p_map_camera.y(), resolution_m_) - reach;
  for (int axis = 0; axis < 3; ++axis) {
    const int origin = axis == 0 ? origin_.x : axis == 1 ? origin_.y : origin_.z;
    offset_[axis] = p_map_camera[axis] / resolution_m_ - origin;
  }
  const size_t size = static_cast<size_t>(layers_) << 2 * width_bits_;
  if (numbers_.size() < size) numbers_.resize(size);
}

void FrameVotes::locate(const PointRow& row, const FloorBand& floor,
                        std::vector<int32_t>* voxels) const {
  voxels->resize(row.depth_m.size());
  int32_t* result = voxels->data();
  const float *depth = row.depth_m.data(), *dx = row.dx_m.data(), *dy = row.dy_m.data(),
              *dz = row.dz_m.data();
  const float scale = cells_per_m_, x0 = static_cast<float>(offset_.x()),
              y0 = static_cast<float>(offset_.y()), z0 = static_cast<float>(offset_.z());
  const int bits = width_bits_, width = 1 << bits, layers = layers_, floor_layer = floor.layer,
            end = row.end;
  const float camera_height = floor.camera_height_m, floor_min = floor.min_height_m,
              metric_min = floor.metric_min_height_m, slope = floor.metric_slope;
  // Written as one choice after the other: that is what compilers make vector instructions of.
  for (int u = row.first; u < end; ++u) {
    const float cell_x = x0 + dx[u] * scale, cell_y = y0 + dy[u] * scale;
    const float cell_z = z0 + dz[u] * scale;
    const int x = floorIndex(cell_x), y = floorIndex(cell_y), free_layer = floorIndex(cell_z);
    const float height = camera_height + dz[u], floor_top = metric_min + slope * depth[u];
    int z = height < floor_top ? floor_layer : free_layer;
    z = height >= floor_min ? z : free_layer;
    const float border_z =
        std::min(measureToBorder(cell_z, free_layer),
                 std::min(std::abs(height - floor_top), std::abs(height - floor_min)));
    const float border =
        std::min(border_z, std::min(measureToBorder(cell_x, x), measureToBorder(cell_y, y)));
    // As unsigned a negative index is a large one.
    const auto rows = (static_cast<unsigned>(z) << bits) + static_cast<unsigned>(y);
    int voxel = static_cast<int>((rows << bits) + static_cast<unsigned>(x));
    voxel = static_cast<unsigned>(x) < static_cast<unsigned>(width) ? voxel : kNoVoxel;
    voxel = static_cast<unsigned>(y) < static_cast<unsigned>(width) ? voxel : kNoVoxel;
    voxel = static_cast<unsigned>(z) < static_cast<unsigned>(layers) ? voxel : kNoVoxel;
    voxel = border < kUncertain ? kUndecided : voxel;
    result[u] = depth[u] > 0.0f ? voxel : kNoVoxel;
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
