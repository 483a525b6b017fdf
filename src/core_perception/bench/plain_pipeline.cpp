// SPDX-License-Identifier: BSD-3-Clause
#include "plain_pipeline.h"

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "image_masks.h"

namespace core_perception {
namespace bench {
namespace {

constexpr double kSite_m = 200.0;  // edge of the square of counts

}  // namespace

PlainPipeline::PlainPipeline(const SemanticMapParams& params) : params_(params) {
  const int cells = static_cast<int>(std::lround(kSite_m / params.resolution_m));
  n_safe_ = cv::Mat::zeros(cells, cells, CV_32SC1);
  n_unsafe_ = cv::Mat::zeros(cells, cells, CV_32SC1);
}

const cv::Mat& PlainPipeline::update(const Frame& frame, const std::vector<Predicate>& predicates) {
  if (!started_) first_ = frame.p_map_base;
  started_ = true;
  count(frame, drawSafeMask(frame, predicates, params_.kernel_px));
  measure(frame.p_map_base);
  return h_m_;
}

void PlainPipeline::count(const Frame& frame, const cv::Mat& safe) {
  const Camera& camera = frame.camera;
  const Eigen::Matrix3d R = frame.T_map_camera.linear();
  const Eigen::Vector3d p = frame.T_map_camera.translation();
  const int half = n_safe_.cols / 2;
  for (int v = 0; v < frame.depth.rows; ++v) {
    for (int u = 0; u < frame.depth.cols; ++u) {
      const double z = frame.depth.at<uint16_t>(v, u) / 1000.0;
      if (z < params_.range.range_min_m || z > params_.range.range_max_m) continue;
      const Eigen::Vector3d point((u - camera.cx_px) / camera.fx_px * z,
                                  (v - camera.cy_px) / camera.fy_px * z, z);
      const Eigen::Vector3d q = R * point + p;
      const int x = static_cast<int>(std::floor(q.x() / params_.resolution_m)) + half;
      const int y = static_cast<int>(std::floor(q.y() / params_.resolution_m)) + half;
      if (x < 0 || y < 0 || x >= n_safe_.cols || y >= n_safe_.rows) continue;
      ++(safe.at<uint8_t>(v, u) != 0 ? n_safe_ : n_unsafe_).at<int>(y, x);
    }
  }
}

void PlainPipeline::measure(const Point2& robot) {
  const double cell_m = params_.resolution_m;
  const int cells = static_cast<int>(std::lround(params_.window_m / cell_m));
  const int half = n_safe_.cols / 2;
  const int x0 = static_cast<int>(std::floor(robot.x / cell_m)) - cells / 2;
  const int y0 = static_cast<int>(std::floor(robot.y / cell_m)) - cells / 2;
  cv::Mat safe(cells, cells, CV_8UC1), unsafe, to_unsafe, to_safe;
  for (int y = 0; y < cells; ++y) {
    for (int x = 0; x < cells; ++x) {
      const double n_safe = n_safe_.at<int>(y0 + y + half, x0 + x + half);
      const double n = n_safe + n_unsafe_.at<int>(y0 + y + half, x0 + x + half);
      const bool is_safe = n > 0.0 ? n_safe / n >= params_.vote.tau : !params_.unknown_is_unsafe;
      safe.at<uint8_t>(y, x) = is_safe ? 255 : 0;
    }
  }
  cv::bitwise_not(safe, unsafe);
  cv::distanceTransform(safe, to_unsafe, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  cv::distanceTransform(unsafe, to_safe, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  h_m_ = (to_unsafe - to_safe) * cell_m;
}

}  // namespace bench
}  // namespace core_perception
