// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/projection.h"

#include <algorithm>
#include <cmath>

namespace core_perception {
namespace {

/// Takes zeros off both ends of [first, end); whole blocks at a time, as vector
/// instructions look at them.
void trimZeros(const float* values, int* first, int* end) {
  constexpr int kBlock = 32;
  const auto isZero = [values](int begin) {
    int n = 0;
    for (int i = 0; i < kBlock; ++i) n += static_cast<int>(values[begin + i] != 0.0f);
    return n == 0;
  };
  while (*end - *first >= kBlock && isZero(*first)) *first += kBlock;
  while (*first < *end && values[*first] == 0.0f) ++*first;
  while (*end - *first >= kBlock && isZero(*end - kBlock)) *end -= kBlock;
  while (*end > *first && values[*end - 1] == 0.0f) --*end;
}

/// Sets depth to 0 where one of the pixels this far to the right, left, below or above is nearer.
/// Written without a branch: that is what compilers make vector instructions of.
void dropBehindEdges(const float* in, std::ptrdiff_t right, std::ptrdiff_t down, float factor,
                     const Run& pixels, float* depth) {
  for (int u = pixels.first; u < pixels.end; ++u) {
    const float limit = in[u] * factor, z = depth[u];
    const auto isNearer = [limit](float other) { return (other > 0.0f) & (other < limit); };
    const bool is_behind = isNearer(in[u - right]) | isNearer(in[u + right]) |
                           isNearer(in[u - down]) | isNearer(in[u + down]);
    depth[u] = is_behind ? 0.0f : z;
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
  for (std::vector<float>* array : {&column_x_, &column_y_, &column_z_})
    array->resize(camera_.width_px);
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
  if (row->depth_m.size() != static_cast<size_t>(metres.cols)) {
    for (std::vector<float>* array : {&row->depth_m, &row->dx_m, &row->dy_m, &row->dz_m})
      array->resize(metres.cols);
  }
  const float* in = metres.ptr<float>(v);
  float* depth = row->depth_m.data();
  const float nearest = range_min_m_, farthest = range_max_m_;
  int first = pixels.first, end = pixels.end;
  for (int u = first; u < end; ++u) {
    const float z = in[u];
    depth[u] = (z >= nearest) & (z <= farthest) ? z : 0.0f;
  }
  const auto stride = static_cast<std::ptrdiff_t>(metres.step1());
  for (int d = 1; d <= edge_px && edge_factor_ > 0.0f; ++d)
    dropBehindEdges(in, d, stride * d, edge_factor_, {first, end}, depth);
  trimZeros(depth, &first, &end);
  row->first = first;
  row->end = end;
  const float row_x = row_[v].x(), row_y = row_[v].y(), row_z = row_[v].z();
  const float *x = column_x_.data(), *y = column_y_.data(), *z = column_z_.data();
  float *dx = row->dx_m.data(), *dy = row->dy_m.data(), *dz = row->dz_m.data();
  for (int u = first; u < end; ++u) dx[u] = (x[u] + row_x) * depth[u];
  for (int u = first; u < end; ++u) dy[u] = (y[u] + row_y) * depth[u];
  for (int u = first; u < end; ++u) dz[u] = (z[u] + row_z) * depth[u];
}

}  // namespace core_perception
