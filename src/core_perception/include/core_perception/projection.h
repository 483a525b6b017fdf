// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/params.h"
#include "core_perception/pixel_set.h"

namespace core_perception {

/// The points of one row of pixels relative to the camera, along the axes of the fixed frame [m].
/// As arrays by coordinate, so that compilers make vector instructions of the loops over them.
struct PointRow {
  PixelRow<float> depth_m;  ///< 0 where the pixel gives no point
  PixelRow<float> dx_m, dy_m, dz_m;
  /// Makes room for so many pixels, in whole blocks.
  void resize(int width) {
    for (PixelRow<float>* array : {&depth_m, &dx_m, &dy_m, &dz_m}) array->resize(blockEnd(width));
  }
  int first = 0, end = 0;  ///< of all others no entry is valid; empty where no pixel gives a point
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
  Eigen::Vector3f ray(int u, int v) const {
    return Eigen::Vector3f(column_x_[u], column_y_[u], column_z_[u]) + row_[v];
  }
  /// Point of a pixel at this depth relative to the camera, in double precision [m].
  Eigen::Vector3d computePoint(int u, int v, double depth_m) const;
  /// Pixel of a point of the fixed frame; z is its depth [m], u and v are meaningless where that is
  /// not positive.
  Eigen::Vector3d project(const Eigen::Vector3d& p_map) const;
  /// Whether a pixel of project() lies before the camera and between the centres of the outermost
  /// pixels.
  bool isInImage(const Eigen::Vector3d& pixel) const {
    return pixel.z() > 0.0 && pixel.x() >= 0.0 && pixel.y() >= 0.0 &&
           pixel.x() <= camera_.width_px - 1 && pixel.y() <= camera_.height_px - 1;
  }
  /// Lowest height of the metric obstacle band for a point at this depth [m].
  float metricHeight(float depth_m) const { return metric_min_height_m_ + metric_slope_ * depth_m; }

  /// Points of the pixels [first, end) of a row that are within range and not on the far side of a
  /// depth edge: a pixel up to edge_px to the left, right, above or below lies nearer by more than
  /// the edge ratio. Such a point is mixed, or the label of the nearer object may have bled onto
  /// it. The near side is kept, so that a thin pole is not lost.
  /// @param metres depth as convertToMetres leaves it.
  /// @param edge_px 1 ... kDepthMargin_px.
  void projectRow(const cv::Mat& metres, int v, const Run& pixels, int edge_px,
                  PointRow* row) const;
  /// The same for a whole row.
  void projectRow(const cv::Mat& metres, int v, PointRow* row) const {
    projectRow(metres, v, {0, metres.cols}, 1, row);
  }

 private:
  void computePoints(int v, PointRow* row) const;

  Camera camera_;
  Eigen::Matrix3d R_map_camera_;
  Eigen::Vector3d p_map_camera_;
  float camera_height_m_, range_min_m_, range_max_m_, metric_min_height_m_, metric_slope_,
      edge_factor_;
  double reach_m_;
  PixelRow<float> column_x_, column_y_, column_z_;  ///< part of the ray that a column shares
  std::vector<Eigen::Vector3f> row_;                ///< the other, with the optical axis in it
};

}  // namespace core_perception
