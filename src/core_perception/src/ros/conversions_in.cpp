// SPDX-License-Identifier: BSD-3-Clause
#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <cmath>

#include "core_perception/exceptions.h"
#include "core_perception/ros/conversions.h"

namespace core_perception {
namespace {

namespace enc = sensor_msgs::image_encodings;

// What no reasoner and no segmenter sends; beyond, a frame would take seconds, and names, which the
// table of causes keeps, would fill the memory.
constexpr size_t kMostPredicates = 256;
constexpr size_t kMostExemptions = 10000;  // of one predicate
constexpr size_t kLongestName = 128;       // bytes
constexpr float kLargestRadius_m = 20.0f;  // as the reasoners allow

void checkName(const std::string& name, const char* reason) {
  if (name.size() <= kLongestName) return;
  throw FrameError(reason, "class name " + toPrintable(name) + " has " +
                               std::to_string(name.size()) + " bytes, allowed " +
                               std::to_string(kLongestName));
}

/// View of the pixels, not a copy.
cv::Mat matFromMessage(const sensor_msgs::Image& image, int type, const char* what) {
  const size_t pixel_size = CV_ELEM_SIZE(type);
  const bool laid_out = image.step >= static_cast<size_t>(image.width) * pixel_size &&
                        image.step % pixel_size == 0 &&
                        image.data.size() >= static_cast<size_t>(image.step) * image.height;
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
                   "depth is " + toPrintable(image.encoding) + ", allowed 32FC1 (m) or 16UC1 (mm)");
}

cv::Mat labelsFromMessage(const sensor_msgs::Image& image) {
  if (image.encoding == enc::MONO16 || image.encoding == enc::TYPE_16UC1) {
    return matFromMessage(image, CV_16UC1, "labels");
  }
  throw FrameError("image_encoding",
                   "labels are " + toPrintable(image.encoding) + ", allowed mono16");
}

Predicate predicateFromMessage(const core_msgs::Predicate& message) {
  const bool valid = message.spatial_operator <= core_msgs::Predicate::BETWEEN &&
                     message.verdict <= core_msgs::Predicate::UNSAFE &&
                     message.severity <= core_msgs::Predicate::SLOW && message.radius_m >= 0.0f &&
                     message.radius_m <= kLargestRadius_m;
  if (!valid) {
    throw FrameError(
        "constraints_invalid",
        "predicate on " + toPrintable(message.class_name) +
            " has an unknown operator, verdict or severity, or a radius outside 0 to " +
            std::to_string(static_cast<int>(kLargestRadius_m)) + " m");
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
void checkConstraints(const core_msgs::SafetyConstraints& message) {
  if (message.predicates.size() > kMostPredicates)
    throw FrameError("constraints_invalid", std::to_string(message.predicates.size()) +
                                                " predicates, allowed " +
                                                std::to_string(kMostPredicates));
  for (const core_msgs::Predicate& predicate : message.predicates) {
    checkName(predicate.class_name, "constraints_invalid");
    const auto& numbers = predicate.exempt_instances;
    if (numbers.size() > kMostExemptions)
      throw FrameError("constraints_invalid", "predicate on " + toPrintable(predicate.class_name) +
                                                  " exempts " + std::to_string(numbers.size()) +
                                                  " instances, allowed " +
                                                  std::to_string(kMostExemptions));
    if (numbers.empty()) continue;
    if (message.instances_history_start.isZero())
      throw FrameError("constraints_invalid", "predicate on " + toPrintable(predicate.class_name) +
                                                  " exempts instances, but "
                                                  "instances_history_start is 0");
    if (std::count(numbers.begin(), numbers.end(), 0u) > 0)
      throw FrameError("constraints_invalid", "predicate on " + toPrintable(predicate.class_name) +
                                                  " exempts instance 0; allowed numbers > 0");
  }
}

/// A camera_info that does not name its frame is taken at its word: many recordings have such.
void checkFrameIds(const FrameMessages& messages) {
  const std::string depth_id = stripSlash(messages.depth->header.frame_id);
  const std::string labels_id = stripSlash(messages.labels->header.frame_id);
  const std::string camera_id = stripSlash(messages.camera_info->header.frame_id);
  const std::string begin = "depth is in '" + toPrintable(depth_id) + "', ";
  if (depth_id.empty() || depth_id != labels_id)
    throw FrameError("frame_id", begin + "labels in '" + toPrintable(labels_id) +
                                     "'; both must be the same optical frame");
  if (!camera_id.empty() && depth_id != camera_id)
    throw FrameError("frame_id", begin + "camera_info in '" + toPrintable(camera_id) +
                                     "'; depth must be registered to that camera");
}

}  // namespace

bool isUsable(const ros::Time& stamp) {
  return !stamp.isZero() && stamp.sec <= 2147483647u && stamp.nsec < 1000000000u;
}

std::string stripSlash(const std::string& frame_id) {
  return !frame_id.empty() && frame_id[0] == '/' ? frame_id.substr(1) : frame_id;
}

Frame frameFromMessages(const FrameMessages& messages, bool ignore_distortion,
                        Rectifier* rectifier) {
  Frame frame;
  frame.depth = depthFromMessage(*messages.depth);
  frame.labels = labelsFromMessage(*messages.labels);
  checkFrameIds(messages);
  if (frame.depth.size() != frame.labels.size()) {
    throw FrameError("image_size", "depth is " + formatSize(frame.depth) + ", labels are " +
                                       formatSize(frame.labels));
  }
  const sensor_msgs::CameraInfo& info = *messages.camera_info;
  if (rectifier != nullptr && hasDistortion(info)) {
    const Distortion lens = distortionFromMessage(info);
    frame.camera = makeCamera(info, frame.depth.cols, frame.depth.rows, false);
    frame.depth = rectifier->rectify(frame.camera, lens, frame.depth);
    frame.labels = rectifier->rectify(frame.camera, lens, frame.labels);
  } else {
    frame.camera = cameraFromMessage(info, frame.depth.cols, frame.depth.rows, ignore_distortion);
  }
  if (!isUsable(messages.depth->header.stamp))
    throw FrameError("stamp_invalid",
                     "depth has a stamp that is 0, beyond 2^31 s or not normalised");
  frame.stamp_s = messages.depth->header.stamp.toSec();
  for (const core_msgs::LabelClass& label : messages.label_info->labels) {
    checkName(label.class_name, "labels_invalid");
    frame.classes.push_back(LabelClass{label.id, label.class_name});
  }
  frame.classes_evaluated = messages.label_info->classes_evaluated;
  return frame;
}

Constraints constraintsFromMessage(const core_msgs::SafetyConstraintsConstPtr& message) {
  Constraints constraints;
  if (message == nullptr) return constraints;
  checkConstraints(*message);
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
