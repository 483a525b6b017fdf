// SPDX-License-Identifier: BSD-3-Clause
#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <cmath>

#include "core_perception/exceptions.h"
#include "core_perception/ros/conversions.h"

namespace core_perception {
namespace {

namespace enc = sensor_msgs::image_encodings;

/// View of the pixels, not a copy.
cv::Mat matFromMessage(const sensor_msgs::Image& image, int type, const char* what) {
  const size_t pixel_size = CV_ELEM_SIZE(type);
  const bool laid_out = image.step >= static_cast<size_t>(image.width) * pixel_size &&
                        image.step % pixel_size == 0 &&
                        image.data.size() >= static_cast<size_t>(image.step) * image.height;
  constexpr uint32_t kLargest_px = 16384;
  if (!laid_out || image.width == 0 || image.height == 0 || image.width > kLargest_px ||
      image.height > kLargest_px) {
    throw FrameError("image_size", std::string(what) + ": " + std::to_string(image.data.size()) +
                                       " bytes do not hold " + std::to_string(image.width) + "x" +
                                       std::to_string(image.height) + " pixels with rows of " +
                                       std::to_string(image.step) + " bytes");
  }
  if (image.is_bigendian != 0)
    throw FrameError("image_encoding", std::string(what) + " is big-endian");
  return cv::Mat(static_cast<int>(image.height), static_cast<int>(image.width), type,
                 const_cast<uint8_t*>(image.data.data()), image.step);
}

std::string formatSize(const cv::Mat& image) {
  return std::to_string(image.cols) + "x" + std::to_string(image.rows);
}

cv::Mat depthFromMessage(const sensor_msgs::Image& image) {
  if (image.encoding == enc::TYPE_32FC1) return matFromMessage(image, CV_32FC1, "depth");
  if (image.encoding == enc::TYPE_16UC1 || image.encoding == enc::MONO16) {
    return matFromMessage(image, CV_16UC1, "depth");
  }
  throw FrameError("image_encoding",
                   "depth is " + image.encoding + ", allowed 32FC1 (m) or 16UC1 (mm)");
}

cv::Mat labelsFromMessage(const sensor_msgs::Image& image) {
  if (image.encoding == enc::MONO16 || image.encoding == enc::TYPE_16UC1) {
    return matFromMessage(image, CV_16UC1, "labels");
  }
  throw FrameError("image_encoding", "labels are " + image.encoding + ", allowed mono16");
}

Predicate predicateFromMessage(const core_msgs::Predicate& message) {
  const bool valid = message.spatial_operator <= core_msgs::Predicate::BETWEEN &&
                     message.verdict <= core_msgs::Predicate::UNSAFE &&
                     message.severity <= core_msgs::Predicate::SLOW && message.radius_m >= 0.0f &&
                     std::isfinite(message.radius_m);
  if (!valid) {
    throw FrameError("constraints_invalid", "predicate on " + message.class_name +
                                                " has an unknown operator, verdict " +
                                                "or severity, or a negative radius");
  }
  Predicate predicate;
  predicate.spatial_operator = static_cast<SpatialOperator>(message.spatial_operator);
  predicate.class_name = message.class_name;
  predicate.verdict = static_cast<Verdict>(message.verdict);
  predicate.severity = static_cast<Severity>(message.severity);
  predicate.radius_m = message.radius_m;
  predicate.exempt_instances.insert(message.exempt_instances.begin(),
                                    message.exempt_instances.end());
  return predicate;
}

/// Numbers of objects mean something only together with the history they count by.
void checkExemptions(const core_msgs::SafetyConstraints& message) {
  for (const core_msgs::Predicate& predicate : message.predicates) {
    const auto& numbers = predicate.exempt_instances;
    if (numbers.empty()) continue;
    if (message.instances_history_start.isZero())
      throw FrameError("constraints_invalid", "predicate on " + predicate.class_name +
                                                  " exempts instances, but "
                                                  "instances_history_start is 0");
    if (std::count(numbers.begin(), numbers.end(), 0u) > 0)
      throw FrameError("constraints_invalid", "predicate on " + predicate.class_name +
                                                  " exempts instance 0; allowed numbers > 0");
  }
}

}  // namespace

Camera cameraFromMessage(const sensor_msgs::CameraInfo& info, int width_px, int height_px,
                         bool ignore_distortion) {
  const bool distorted =
      std::any_of(info.D.begin(), info.D.end(), [](double d) { return d != 0.0; });
  if (distorted && !ignore_distortion) {
    throw FrameError(
        "distorted",
        "camera_info has distortion; rectify the images, or set ignore_distortion if they are");
  }
  if (info.binning_x > 1 || info.binning_y > 1 || info.roi.x_offset != 0 ||
      info.roi.y_offset != 0) {
    throw FrameError("camera_invalid",
                     "camera_info with binning or a region of interest is not supported");
  }
  const double shape =
      static_cast<double>(info.width) * height_px - static_cast<double>(info.height) * width_px;
  if (info.width == 0 || info.height == 0 || std::abs(shape) > 0.02 * info.width * height_px) {
    throw FrameError("camera_invalid", "camera_info is for " + std::to_string(info.width) + "x" +
                                           std::to_string(info.height) + ", the images are " +
                                           std::to_string(width_px) + "x" +
                                           std::to_string(height_px));
  }
  const Camera camera{info.K[0],
                      info.K[4],
                      info.K[2],
                      info.K[5],
                      static_cast<int>(info.width),
                      static_cast<int>(info.height)};
  return scaleCamera(camera, width_px, height_px);
}

Frame frameFromMessages(const FrameMessages& messages, bool ignore_distortion) {
  Frame frame;
  frame.depth = depthFromMessage(*messages.depth);
  frame.labels = labelsFromMessage(*messages.labels);
  const std::string& depth_id = messages.depth->header.frame_id;
  if (depth_id.empty() || depth_id != messages.labels->header.frame_id) {
    throw FrameError("frame_id", "depth is in '" + depth_id + "', labels in '" +
                                     messages.labels->header.frame_id +
                                     "'; both must be the same optical frame");
  }
  if (frame.depth.size() != frame.labels.size()) {
    throw FrameError("image_size", "depth is " + formatSize(frame.depth) + ", labels are " +
                                       formatSize(frame.labels));
  }
  frame.camera = cameraFromMessage(*messages.camera_info, frame.depth.cols, frame.depth.rows,
                                   ignore_distortion);
  frame.stamp_s = messages.depth->header.stamp.toSec();
  for (const core_msgs::LabelClass& label : messages.label_info->labels) {
    frame.classes.push_back(LabelClass{label.id, label.class_name});
  }
  frame.classes_evaluated = messages.label_info->classes_evaluated;
  return frame;
}

Constraints constraintsFromMessage(const core_msgs::SafetyConstraintsConstPtr& message) {
  Constraints constraints;
  if (message == nullptr) return constraints;
  checkExemptions(*message);
  constraints.image_stamp_s = message->image_stamp.toSec();
  constraints.instances_history_start_s = message->instances_history_start.toSec();
  for (const core_msgs::Predicate& predicate : message->predicates) {
    constraints.predicates.push_back(predicateFromMessage(predicate));
  }
  return constraints;
}

ParamValue paramFromXmlRpc(const XmlRpc::XmlRpcValue& value) {
  XmlRpc::XmlRpcValue copy = value;  // its conversions are not const
  ParamValue result;
  switch (copy.getType()) {
    case XmlRpc::XmlRpcValue::TypeBoolean:
      return ParamValue::ofBool(static_cast<bool>(copy));
    case XmlRpc::XmlRpcValue::TypeInt:
      return ParamValue::ofInt(static_cast<int>(copy));
    case XmlRpc::XmlRpcValue::TypeDouble:
      return ParamValue::ofDouble(static_cast<double>(copy));
    case XmlRpc::XmlRpcValue::TypeString:
      return ParamValue::ofString(static_cast<std::string>(copy));
    case XmlRpc::XmlRpcValue::TypeArray:
      result.kind = ParamValue::Kind::kList;
      for (int i = 0; i < copy.size(); ++i) result.list.push_back(paramFromXmlRpc(copy[i]));
      break;
    case XmlRpc::XmlRpcValue::TypeStruct:
      result.kind = ParamValue::Kind::kStruct;
      for (auto& member : copy) result.members[member.first] = paramFromXmlRpc(member.second);
      break;
    default:
      break;
  }
  return result;
}

}  // namespace core_perception
