// SPDX-License-Identifier: BSD-3-Clause
#include "refusal_rules.h"

#include <cmath>
#include <map>
#include <string>

namespace core_perception {
namespace fuzz {
namespace {

bool isWrongImage(const sensor_msgs::Image& image, bool depth) {
  const bool metres = depth && image.encoding == "32FC1";
  if (!metres && image.encoding != "16UC1" && image.encoding != "mono16") return true;
  const uint64_t row_bytes = static_cast<uint64_t>(image.width) * (metres ? 4 : 2);
  return image.width == 0 || image.height == 0 || image.is_bigendian != 0 ||
         image.step < row_bytes ||
         static_cast<uint64_t>(image.step) * image.height > image.data.size();
}

/// Frames of old recordings begin with a slash, which tf2 does not take.
std::string withoutSlash(const std::string& frame_id) {
  return !frame_id.empty() && frame_id[0] == '/' ? frame_id.substr(1) : frame_id;
}

bool isFocalLength(double value) { return std::isfinite(value) && value > 0.0; }

bool isWrongLens(const sensor_msgs::CameraInfo& info, Lens lens) {
  for (const double d : info.D) {
    if (lens == Lens::kRefused && !(d == 0.0)) return true;
    if (lens == Lens::kRectified && !std::isfinite(d)) return true;
  }
  return false;
}

bool isWrongCamera(const sensor_msgs::CameraInfo& info, const sensor_msgs::Image& image,
                   Lens lens) {
  if (isWrongLens(info, lens) || info.width == 0 || info.height == 0) return true;
  const auto& roi = info.roi;
  if (static_cast<uint64_t>(roi.x_offset) + roi.width > info.width ||
      static_cast<uint64_t>(roi.y_offset) + roi.height > info.height)
    return true;
  const bool whole = info.binning_x <= 1 && info.binning_y <= 1 && roi.width == 0 &&
                     roi.height == 0 && roi.x_offset == 0 && roi.y_offset == 0;
  const double shape = static_cast<double>(info.width) / info.height;
  const double image_shape = static_cast<double>(image.width) / image.height;
  if (whole && std::abs(shape / image_shape - 1.0) > 0.05) return true;
  if (lens == Lens::kIgnored && info.P[0] != 0.0) return false;  // it may count instead of K
  return !isFocalLength(info.K[0]) || !isFocalLength(info.K[4]) || !std::isfinite(info.K[2]) ||
         !std::isfinite(info.K[5]);
}

bool isAmbiguous(const core_msgs::LabelInfo& info) {
  std::map<uint16_t, std::string> names;
  for (const core_msgs::LabelClass& label : info.labels) {
    if (names.emplace(label.id, label.class_name).first->second != label.class_name) return true;
  }
  return false;
}

bool isWrongPredicate(const core_msgs::Predicate& predicate, bool has_history) {
  for (const uint32_t number : predicate.exempt_instances) {
    if (number == 0 || !has_history) return true;
  }
  return predicate.spatial_operator > 3 || predicate.verdict > 1 || predicate.severity > 1 ||
         !std::isfinite(predicate.radius_m) || predicate.radius_m < 0.0f;
}

bool isWrongPose(const Eigen::Isometry3d& T, const Point2& base) {
  const Eigen::Matrix3d R = T.linear();
  const double most = T.matrix().cwiseAbs().maxCoeff();
  return !T.matrix().allFinite() || most > 5000.0 || !(R * R.transpose()).isIdentity(1e-2) ||
         R.determinant() < 0.0 || !(std::abs(base.x) <= 5000.0) || !(std::abs(base.y) <= 5000.0);
}

}  // namespace

const char* findBrokenRule(const FrameMessages& messages, const Eigen::Isometry3d& T_map_camera,
                           const Point2& p_map_base, Lens lens) {
  const sensor_msgs::Image& depth = *messages.depth;
  const sensor_msgs::Image& labels = *messages.labels;
  if (isWrongImage(depth, true)) return "depth";
  if (isWrongImage(labels, false)) return "labels";
  if (depth.width != labels.width || depth.height != labels.height) return "sizes";
  const std::string depth_id = withoutSlash(depth.header.frame_id);
  const std::string camera_id = withoutSlash(messages.camera_info->header.frame_id);
  if (depth_id.empty() || depth_id != withoutSlash(labels.header.frame_id) ||
      (!camera_id.empty() && camera_id != depth_id))
    return "frame_id";
  if (depth.header.stamp.sec == 0 && depth.header.stamp.nsec == 0) return "stamp";
  if (isWrongCamera(*messages.camera_info, depth, lens)) return "camera_info";
  if (isAmbiguous(*messages.label_info)) return "label_info";
  if (messages.constraints != nullptr) {
    const ros::Time& start = messages.constraints->instances_history_start;
    for (const core_msgs::Predicate& predicate : messages.constraints->predicates) {
      if (isWrongPredicate(predicate, start.sec != 0 || start.nsec != 0)) return "constraints";
    }
  }
  return isWrongPose(T_map_camera, p_map_base) ? "pose" : nullptr;
}

}  // namespace fuzz
}  // namespace core_perception
