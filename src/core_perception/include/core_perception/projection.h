// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/params.h"

namespace core_perception {

/// A pixel with depth, and its point relative to the camera along the axes of the fixed frame [m].
struct PixelPoint {
  int u, v;
  float depth_m;
  float dx_m, dy_m, dz_m;
};

/// Back-projection of one frame. All rays of a row share their constant part.
class Projection {
 public:
  Projection(const Frame& frame, const RangeParams& range);

  const Camera& camera() const { return camera_; }
  const Eigen::Vector3d& p_map_camera() const { return p_map_camera_; }
  /// Height of the camera above the floor [m].
  float camera_height_m() const { return camera_height_m_; }
  /// Largest distance along the ground at which a point within range can lie [m]: z-depth 7 m
  /// reaches farther.
  double reach_m() const { return reach_m_; }
  /// Direction of a pixel's ray per metre of depth, in the fixed frame.
  Eigen::Vector3f ray(int u, int v) const { return ray_x_[u] + ray_y_[v]; }
  /// Pixel of a point of the fixed frame; z is its depth [m], u and v are meaningless where that is
  /// not positive.
  Eigen::Vector3d project(const Eigen::Vector3d& p_map) const;
  /// Lowest height of the metric obstacle band for a point at this depth [m].
  float metricHeight(float depth_m) const { return metric_min_height_m_ + metric_slope_ * depth_m; }

  /// Calls visit(PixelPoint) for every pixel that is within range and not on the far side of a
  /// depth edge, row by row.
  /// @param metres depth as convertToMetres leaves it.
  template <typename Visitor>
  void forEachPoint(const cv::Mat& metres, Visitor&& visit) const;
  /// Whether a pixel this far to the left, right, above or below lies nearer by more than the edge
  /// ratio.
  bool isBehindEdge(const cv::Mat& metres, int u, int v, int distance_px) const;

 private:
  Camera camera_;
  Eigen::Matrix3d R_map_camera_;
  Eigen::Vector3d p_map_camera_;
  float camera_height_m_, range_min_m_, range_max_m_, metric_min_height_m_, metric_slope_,
      edge_factor_;
  double reach_m_;
  std::vector<Eigen::Vector3f> ray_x_,
      ray_y_;  ///< per column; per row, with the optical axis added
};

/// A pixel is dropped when one of its four neighbours lies nearer by more than the edge ratio: it
/// is a mixed pixel, or the label of the nearer object may have bled onto it. The near side is
/// kept, so that a thin pole is not lost.
inline bool Projection::isBehindEdge(const cv::Mat& metres, int u, int v, int distance_px) const {
  const float* row = metres.ptr<float>(v);
  const float limit = row[u] * edge_factor_;  // 0 when the test is off
  const auto nearer = [limit](float other) { return other > 0.0f && other < limit; };
  const int d = distance_px;
  return (u >= d && nearer(row[u - d])) || (u + d < metres.cols && nearer(row[u + d])) ||
         (v >= d && nearer(metres.ptr<float>(v - d)[u])) ||
         (v + d < metres.rows && nearer(metres.ptr<float>(v + d)[u]));
}

template <typename Visitor>
void Projection::forEachPoint(const cv::Mat& metres, Visitor&& visit) const {
  for (int v = 0; v < metres.rows; ++v) {
    const float* depth = metres.ptr<float>(v);
    for (int u = 0; u < metres.cols; ++u) {
      const float z = depth[u];
      if (!(z >= range_min_m_ && z <= range_max_m_)) continue;
      if (edge_factor_ > 0.0f && isBehindEdge(metres, u, v, 1)) continue;
      const Eigen::Vector3f d = ray(u, v) * z;
      visit(PixelPoint{u, v, z, d.x(), d.y(), d.z()});
    }
  }
}

}  // namespace core_perception
