// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/projection.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace core_perception {
namespace {

/// Copies what lies within [nearest, farthest], 0 for the rest.
/// @returns how many values do.
int keepWithin(const float* in, float nearest, float farthest, int n, float* depth) {
  int n_within = 0;
  for (int i = 0; i < n; ++i) {
    const float z = in[i];
    const bool is_within = (z >= nearest) & (z <= farthest);
    depth[i] = is_within ? z : 0.0f;
    n_within += static_cast<int>(is_within);
  }
  return n_within;
}

/// out = (column + row) depth
void scaleRays(const float* column, float row, const float* depth, int n, float* out) {
  for (int i = 0; i < n; ++i) out[i] = (column[i] + row) * depth[i];
}

/// Whether so many values are +0: whole numbers are quick to compare.
template <int n>
bool isZero(const float* values) {
  uint32_t bits[n], any = 0;
  std::memcpy(bits, values, sizeof(bits));
  for (int i = 0; i < n; ++i) any |= bits[i];
  return any == 0;
}

/// Takes zeros off both ends of [first, end), so many at a time.
template <int step>
void trimZeros(const float* values, int* first, int* end) {
  while (*end - *first >= step && isZero<step>(values + *first)) *first += step;
  while (*end - *first >= step && isZero<step>(values + *end - step)) *end -= step;
}

/// Sets depth to 0 where one of the pixels this far to the right, left, below or above is nearer.
/// Written without a branch: that is what compilers make vector instructions of.
void dropBehindEdges(const float* in, std::ptrdiff_t right, std::ptrdiff_t down, float factor,
                     int n, float* depth) {
  for (int i = 0; i < n; ++i) {
    const float limit = in[i] * factor, z = depth[i];
    const auto isNearer = [limit](float other) { return (other > 0.0f) & (other < limit); };
    const bool is_behind = isNearer(in[i - right]) | isNearer(in[i + right]) |
                           isNearer(in[i - down]) | isNearer(in[i + down]);
    depth[i] = is_behind ? 0.0f : z;
  }
}

}  // namespace

Projection::Projection(const Frame& frame, const RangeParams& range)
    : camera_(frame.camera),
      R_map_camera_(frame.T_map_camera.linear()),
      p_map_camera_(frame.T_map_camera.translation()),
      camera_height_m_(static_cast<float>(p_map_camera_.z() - range.floor_z_m)),
      range_min_m_(static_cast<float>(range.range_min_m)),
      range_max_m_(static_cast<float>(range.range_max_m)),
      metric_min_height_m_(static_cast<float>(range.metric_min_height_m)),
      metric_slope_(static_cast<float>(range.metric_slope)),
      edge_factor_(range.depth_edge_ratio > 0.0 ? static_cast<float>(1.0 - range.depth_edge_ratio)
                                                : 0.0f),
      reach_m_(range.range_max_m * computeLongestRay(camera_)) {
  for (PixelRow<float>* array : {&column_x_, &column_y_, &column_z_})
    array->resize(blockEnd(camera_.width_px));
  row_.reserve(camera_.height_px);
  for (int u = 0; u < camera_.width_px; ++u) {
    const Eigen::Vector3d ray = R_map_camera_.col(0) * ((u - camera_.cx_px) / camera_.fx_px);
    column_x_[u] = static_cast<float>(ray.x());
    column_y_[u] = static_cast<float>(ray.y());
    column_z_[u] = static_cast<float>(ray.z());
  }
  for (int v = 0; v < camera_.height_px; ++v) {
    const double y = (v - camera_.cy_px) / camera_.fy_px;
    row_.push_back((R_map_camera_.col(1) * y + R_map_camera_.col(2)).cast<float>());
  }
}

Eigen::Vector3d Projection::project(const Eigen::Vector3d& p_map) const {
  const Eigen::Vector3d p = R_map_camera_.transpose() * (p_map - p_map_camera_);
  return {camera_.fx_px * p.x() / p.z() + camera_.cx_px,
          camera_.fy_px * p.y() / p.z() + camera_.cy_px, p.z()};
}

Eigen::Vector3d Projection::computePoint(int u, int v, double depth_m) const {
  const Eigen::Vector3d ray((u - camera_.cx_px) / camera_.fx_px,
                            (v - camera_.cy_px) / camera_.fy_px, 1.0);
  return R_map_camera_ * (ray * depth_m);
}

void Projection::projectRow(const cv::Mat& metres, int v, const Run& pixels, int edge_px,
                            PointRow* row) const {
  row->resize(metres.cols);
  row->first = row->end = pixels.first;
  const float* in = metres.ptr<float>(v);
  float* depth = row->depth_m.data();
  const int begin = blockBegin(pixels.first), end = blockEnd(pixels.end);
  if (keepWithin(in + begin, range_min_m_, range_max_m_, end - begin, depth + begin) == 0) return;
  row->end = pixels.end;
  trimZeros<4 * kBlock_px>(depth, &row->first, &row->end);
  trimZeros<kBlock_px>(depth, &row->first, &row->end);
  const auto stride = static_cast<std::ptrdiff_t>(metres.step1());
  const int first = blockBegin(row->first), n = blockEnd(row->end) - first;
  for (int d = 1; d <= edge_px && edge_factor_ > 0.0f; ++d)
    dropBehindEdges(in + first, d, stride * d, edge_factor_, n, depth + first);
  computePoints(v, row);
}

void Projection::computePoints(int v, PointRow* row) const {
  const int begin = blockBegin(row->first);
  const int n = blockEnd(row->end) - begin;
  const float* depth = row->depth_m.data() + begin;
  scaleRays(column_x_.data() + begin, row_[v].x(), depth, n, row->dx_m.data() + begin);
  scaleRays(column_y_.data() + begin, row_[v].y(), depth, n, row->dy_m.data() + begin);
  scaleRays(column_z_.data() + begin, row_[v].z(), depth, n, row->dz_m.data() + begin);
}

}  // namespace core_perception
