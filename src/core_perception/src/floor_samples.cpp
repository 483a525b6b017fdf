// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/floor_samples.h"

#include <algorithm>
#include <cmath>

namespace core_perception {

FloorSamples::FloorSamples(double cell_m, const RangeParams& range, float grade)
    : cell_m_(cell_m),
      range_max_m_(static_cast<float>(range.range_max_m)),
      band_max_m_(static_cast<float>(range.band_max_z_m)),
      grade_(grade) {}

void FloorSamples::collect(const cv::Mat& metres, const Projection& projection, CellIndex origin,
                           int width, float floor_m) {
  origin_ = origin;
  width_ = width;
  columns_.assign(static_cast<size_t>(width) * width, ColumnSamples());
  const Camera& camera = projection.camera();
  const auto cell_m = static_cast<float>(cell_m_);
  const auto fx = static_cast<float>(camera.fx_px), fy = static_cast<float>(camera.fy_px);
  top_m_ = floor_m + band_max_m_;
  const float height_m = std::max(0.1f, projection.camera_height_m() - floor_m);
  for (int v = 0; v < metres.rows;) {
    const float down = -projection.ray(metres.cols / 2, v).z();
    const bool reaches_ground = down * range_max_m_ > height_m;
    float depth_m = reaches_ground ? height_m / down : range_max_m_;
    // Ground that falls lies farther off.
    constexpr int kProbes = 16;
    for (int i = 0; i < kProbes; ++i) {
      const float probe_m = metres.ptr<float>(v)[metres.cols * i / kProbes];
      if (probe_m <= range_max_m_) depth_m = std::max(depth_m, probe_m);
    }
    // Near by the ground comes in many rows; above the horizon only what rises steeply is seen.
    const bool is_dense = down <= 0.0f || 8.0f * depth_m * depth_m < cell_m * height_m * fy;
    // Four samples across a column of the map, or two in many rows.
    const float wanted_px = (is_dense ? 0.5f : 0.25f) * cell_m * fx / depth_m;
    // Infinite, or no number, for a camera at the height of the floor; in this order a whole row.
    const float step_px = std::max(1.0f, std::min(static_cast<float>(metres.cols), wanted_px));
    collectRow(metres, projection, v, static_cast<int>(step_px + 0.5f));
    v += is_dense ? 2 : 1;
  }
}

void FloorSamples::collectRow(const cv::Mat& metres, const Projection& projection, int v,
                              int step_px) {
  projection.projectRow(metres, v, &row_);
  const Eigen::Vector3d& camera = projection.p_map_camera();
  const auto cells_per_m = static_cast<float>(1.0 / cell_m_);
  const auto x0 = static_cast<float>(camera.x() / cell_m_ - origin_.x);
  const auto y0 = static_cast<float>(camera.y() / cell_m_ - origin_.y);
  for (int u = row_.first; u < row_.end; u += step_px) {
    const float depth_m = row_.depth_m[u];
    if (depth_m == 0.0f) continue;
    // Within reach neither is negative, so that the conversion is floor().
    const int x = static_cast<int>(x0 + row_.dx_m[u] * cells_per_m);
    const int y = static_cast<int>(y0 + row_.dy_m[u] * cells_per_m);
    if (x < 0 || y < 0 || x >= width_ || y >= width_) continue;
    const float z_m = projection.camera_height_m() + row_.dz_m[u];
    ColumnSamples& column = columns_[static_cast<size_t>(y) * width_ + x];
    const float counted_m =
        z_m < top_m_ + grade_ * depth_m ? z_m : -std::numeric_limits<float>::infinity();
    column.highest = std::max(column.highest, counted_m);
    column.third = std::min(std::max(z_m, column.second), column.third);
    column.second = std::min(std::max(z_m, column.first), column.second);
    column.first = std::min(z_m, column.first);
  }
}

}  // namespace core_perception
