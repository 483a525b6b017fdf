// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/frame.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "core_perception/exceptions.h"

namespace core_perception {
namespace {

std::string formatSize(int width, int height) {
  return std::to_string(width) + "x" + std::to_string(height);
}

bool isPositive(double value) { return std::isfinite(value) && value > 0.0; }

void checkImages(const Frame& frame) {
  const cv::Mat& depth = frame.depth;
  const cv::Mat& labels = frame.labels;
  if (depth.empty() || labels.empty())
    throw FrameError("image_empty", "depth or labels hold no pixel");
  if (depth.type() != CV_32FC1 && depth.type() != CV_16UC1) {
    throw FrameError("image_type", "depth must be 32FC1 in metres or 16UC1 in millimetres");
  }
  if (labels.type() != CV_16UC1) throw FrameError("image_type", "labels must be mono16");
  const Camera& camera = frame.camera;
  if (depth.size() != labels.size() || depth.cols != camera.width_px ||
      depth.rows != camera.height_px) {
    throw FrameError("image_size", "depth " + formatSize(depth.cols, depth.rows) + ", labels " +
                                       formatSize(labels.cols, labels.rows) + ", camera " +
                                       formatSize(camera.width_px, camera.height_px) +
                                       " must be equal");
  }
}

/// A label that stands for two classes could hide an unsafe one behind a safe one.
void checkClasses(const Frame& frame) {
  std::map<uint16_t, std::string> names;
  for (const LabelClass& listed : frame.classes) {
    const auto& known = *names.emplace(listed.id, listed.class_name).first;
    if (known.second == listed.class_name) continue;
    throw FrameError("labels_invalid", "label " + std::to_string(listed.id) + " is listed as " +
                                           toPrintable(known.second) + " and as " +
                                           toPrintable(listed.class_name));
  }
}

void checkPose(const Frame& frame) {
  // 5 km is what a tree of 2^16 cells of 0.2 m can hold; for finer ones SemanticMap checks.
  constexpr double kFarthest_m = 5000.0;
  const Eigen::Matrix3d R = frame.T_map_camera.linear();
  const double farthest_m = frame.T_map_camera.translation().cwiseAbs().maxCoeff();
  // Written so that NaN fails.
  const bool valid = frame.T_map_camera.matrix().allFinite() && farthest_m <= kFarthest_m &&
                     std::abs(frame.p_map_base.x) <= kFarthest_m &&
                     std::abs(frame.p_map_base.y) <= kFarthest_m &&
                     (R * R.transpose()).isIdentity(1e-3) && R.determinant() > 0.0;
  if (!valid) {
    throw FrameError("pose_invalid", "poses must be finite, rigid and within 5 km of the origin");
  }
}

/// depth_mm / 1000.0f to the last bit, without its division: the product with the first bits of
/// 1 / 1000 is exact, and what the other one rounds away is too little to matter.
inline float toMetres(uint16_t depth_mm) {
  constexpr double kFirstBits = 262.0 / (1 << 18);
  constexpr auto kHigh = static_cast<float>(kFirstBits);
  constexpr auto kLow = static_cast<float>(1e-3 - kFirstBits);
  return static_cast<float>(depth_mm) * kHigh + static_cast<float>(depth_mm) * kLow;
}

/// 0 for what is no depth.
inline float toMetres(float depth_m) {
  constexpr float kLargest = std::numeric_limits<float>::max();
  return (depth_m > 0.0f) & (depth_m <= kLargest) ? depth_m : 0.0f;  // false for NaN
}

template <typename T>
void convertRow(const T* in, int n, float* out) {
  for (int i = 0; i < n; ++i) out[i] = toMetres(in[i]);
}

}  // namespace

Camera scaleCamera(const Camera& camera, int width_px, int height_px) {
  const double sx = static_cast<double>(width_px) / camera.width_px;
  const double sy = static_cast<double>(height_px) / camera.height_px;
  Camera scaled;
  scaled.fx_px = camera.fx_px * sx;
  scaled.fy_px = camera.fy_px * sy;
  // Pixel borders, not centres, scale.
  scaled.cx_px = (camera.cx_px + 0.5) * sx - 0.5;
  scaled.cy_px = (camera.cy_px + 0.5) * sy - 0.5;
  scaled.width_px = width_px;
  scaled.height_px = height_px;
  return scaled;
}

double computeLongestRay(const Camera& camera) {
  double longest = 0.0;
  for (const double u : {0.0, camera.width_px - 1.0}) {
    for (const double v : {0.0, camera.height_px - 1.0}) {
      const double x = (u - camera.cx_px) / camera.fx_px, y = (v - camera.cy_px) / camera.fy_px;
      longest = std::max(longest, std::sqrt(x * x + y * y + 1.0));
    }
  }
  return longest;
}

void checkFrame(const Frame& frame) {
  checkImages(frame);
  checkClasses(frame);
  const Camera& camera = frame.camera;
  if (!isPositive(camera.fx_px) || !isPositive(camera.fy_px) || !std::isfinite(camera.cx_px) ||
      !std::isfinite(camera.cy_px)) {
    throw FrameError("camera_invalid", "focal lengths must be positive and the centre finite");
  }
  // Also bounds the memory of the scratch volume.
  constexpr double kLongestRay = 3.0;
  if (!(computeLongestRay(camera) <= kLongestRay)) {
    throw FrameError("camera_invalid", "a view wider than 140 degrees is no pinhole camera");
  }
  if (!isPositive(frame.stamp_s)) throw FrameError("stamp_invalid", "the stamp must be positive");
  checkPose(frame);
}

void makeMetres(const cv::Mat& depth, cv::Mat* metres) {
  if (metres->size() == depth.size()) return;
  // Rows that begin with a block lie well for vector instructions.
  constexpr int left = kBlock_px, above = kDepthMargin_px;
  const cv::Mat whole =
      cv::Mat::zeros(depth.rows + 2 * above, blockEnd(depth.cols) + 2 * left, CV_32FC1);
  *metres = whole(cv::Rect(left, above, depth.cols, depth.rows));
}

void convertRowToMetres(const cv::Mat& depth, int v, cv::Mat* metres) {
  if (depth.type() == CV_16UC1) {
    convertRow(depth.ptr<uint16_t>(v), depth.cols, metres->ptr<float>(v));
  } else {
    convertRow(depth.ptr<float>(v), depth.cols, metres->ptr<float>(v));
  }
}

void convertToMetres(const cv::Mat& depth, cv::Mat* metres) {
  makeMetres(depth, metres);
  for (int v = 0; v < depth.rows; ++v) convertRowToMetres(depth, v, metres);
}

}  // namespace core_perception
