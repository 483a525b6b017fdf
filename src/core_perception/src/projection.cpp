// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/projection.h"

#include <algorithm>
#include <cmath>

namespace core_perception {
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
  for (int u = 0; u < camera_.width_px; ++u) {
    const Eigen::Vector3d ray = R_map_camera_.col(0) * ((u - camera_.cx_px) / camera_.fx_px);
    column_x_.push_back(static_cast<float>(ray.x()));
    column_y_.push_back(static_cast<float>(ray.y()));
    column_z_.push_back(static_cast<float>(ray.z()));
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

void Projection::projectRow(const cv::Mat& metres, int v, PointRow* row) const {
  const int n = metres.cols;
  for (std::vector<float>* array : {&row->depth_m, &row->dx_m, &row->dy_m, &row->dz_m})
    array->resize(n);
  const float* in = metres.ptr<float>(v);
  const auto stride = static_cast<std::ptrdiff_t>(metres.step1());
  float* depth = row->depth_m.data();
  const float nearest = range_min_m_, farthest = range_max_m_;
  for (int u = 0; u < n; ++u) {
    const float z = in[u];
    // A factor of 0 turns the test of edges off.
    const bool is_used = (z >= nearest) & (z <= farthest) & !isBehindEdge(in + u, stride, 1);
    depth[u] = is_used ? z : 0.0f;
  }
  const auto is_point = [](float z) { return z > 0.0f; };
  row->first = static_cast<int>(std::find_if(depth, depth + n, is_point) - depth);
  row->end = n;
  while (row->end > row->first && !is_point(depth[row->end - 1])) --row->end;
  const int first = row->first, end = row->end;
  const float row_x = row_[v].x(), row_y = row_[v].y(), row_z = row_[v].z();
  const float *x = column_x_.data(), *y = column_y_.data(), *z = column_z_.data();
  float *dx = row->dx_m.data(), *dy = row->dy_m.data(), *dz = row->dz_m.data();
  for (int u = first; u < end; ++u) dx[u] = (x[u] + row_x) * depth[u];
  for (int u = first; u < end; ++u) dy[u] = (y[u] + row_y) * depth[u];
  for (int u = first; u < end; ++u) dz[u] = (z[u] + row_z) * depth[u];
}

}  // namespace core_perception
