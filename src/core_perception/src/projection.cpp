// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/projection.h"

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
  ray_x_.reserve(camera_.width_px);
  ray_y_.reserve(camera_.height_px);
  for (int u = 0; u < camera_.width_px; ++u) {
    ray_x_.push_back((R_map_camera_.col(0) * ((u - camera_.cx_px) / camera_.fx_px)).cast<float>());
  }
  for (int v = 0; v < camera_.height_px; ++v) {
    const double y = (v - camera_.cy_px) / camera_.fy_px;
    ray_y_.push_back((R_map_camera_.col(1) * y + R_map_camera_.col(2)).cast<float>());
  }
}

Eigen::Vector3d Projection::project(const Eigen::Vector3d& p_map) const {
  const Eigen::Vector3d p = R_map_camera_.transpose() * (p_map - p_map_camera_);
  return {camera_.fx_px * p.x() / p.z() + camera_.cx_px,
          camera_.fy_px * p.y() / p.z() + camera_.cy_px, p.z()};
}

}  // namespace core_perception
