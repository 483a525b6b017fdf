// SPDX-License-Identifier: BSD-3-Clause
#include <sensor_msgs/image_encodings.h>

#include <string>
#include <vector>

#include "draw_messages.h"

namespace core_perception {
namespace fuzz {
namespace {

namespace enc = sensor_msgs::image_encodings;

std::string drawEncoding(ByteSource* source) {
  static const std::vector<std::string> kNames = {
      "",     "rgb8",  "bgr8",     "mono8",  enc::TYPE_16SC1, enc::TYPE_64FC1, enc::TYPE_32FC2,
      "32FC", "32fc1", "16UC1\n ", "mono16", enc::TYPE_16UC1, enc::TYPE_32FC1, "8UC1; compressed"};
  return kNames[source->pick(static_cast<uint32_t>(kNames.size()))];
}

void spoilImage(ByteSource* source, sensor_msgs::Image* image) {
  switch (source->pick(8)) {
    case 0:
      image->width = source->specialCount();
      break;
    case 1:
      image->height = source->specialCount();
      break;
    case 2:
      image->step = source->specialCount();
      break;
    case 3:
      image->encoding = drawEncoding(source);
      break;
    case 4:
      image->is_bigendian = source->raw<uint8_t>();
      break;
    case 5:
      image->data.resize(source->pick(16000));
      break;
    case 6:
      image->header.stamp = drawStamp(source);
      break;
    default:
      image->header.frame_id = drawName(source);
  }
}

void spoilLens(ByteSource* source, sensor_msgs::CameraInfo* info) {
  static const char* const kModels[] = {"plumb_bob", "rational_polynomial", "equidistant", "",
                                        "two\nlines"};
  info->distortion_model = kModels[source->pick(5)];
  info->D.resize(source->pick(15));
  for (double& d : info->D) d = source->flag() ? source->specialNumber() : source->around(0, 0.5);
  if (source->flag()) return;
  info->P = {info->K[0], 0.0, info->K[2], 0.0, 0.0, info->K[4],
             info->K[5], 0.0, 0.0,        0.0, 1.0, 0.0};
  if (!source->flag()) return;
  const uint32_t i = source->pick(12);
  info->P[i] = source->specialNumber();
}

void spoilRegion(ByteSource* source, sensor_msgs::CameraInfo* info) {
  auto& roi = info->roi;
  for (uint32_t* field : {&roi.x_offset, &roi.y_offset, &roi.width, &roi.height, &info->binning_x,
                          &info->binning_y}) {
    if (source->flag()) *field = source->flag() ? source->specialCount() : source->pick(70);
  }
  roi.do_rectify = source->raw<uint8_t>();
}

void spoilCamera(ByteSource* source, sensor_msgs::CameraInfo* info) {
  switch (source->pick(9)) {
    case 0:
      info->width = source->specialCount();
      break;
    case 1:
      info->height = source->specialCount();
      break;
    case 2:
      info->width *= 2;  // the same view at another size
      info->height *= 2;
      break;
    case 3:
    case 4:
      spoilLens(source, info);
      break;
    case 5:
      spoilRegion(source, info);
      break;
    case 6:
      info->header.stamp = drawStamp(source);
      break;
    case 7:
      info->header.frame_id = drawName(source);
      break;
    default: {
      const uint32_t i = source->pick(9);
      info->K[i] = source->specialNumber();
    }
  }
}

void spoilLabelInfo(ByteSource* source, core_msgs::LabelInfo* info) {
  core_msgs::LabelClass label;
  label.id = static_cast<uint16_t>(source->pick(6));  // one that is listed, or the reserved 0
  label.class_name = drawName(source);
  switch (source->pick(4)) {
    case 0:
      info->labels.push_back(label);
      break;
    case 1:
      info->labels.clear();
      break;
    case 2:
      info->classes_evaluated.push_back(drawName(source));
      break;
    default:
      info->header.stamp = drawStamp(source);
  }
}

void spoilPose(ByteSource* source, DrawnFrame* frame) {
  switch (source->pick(4)) {
    case 0: {  // what tf2::transformToEigen makes of such a quaternion
      Eigen::Quaterniond q(source->specialNumber(), 0.0, 0.0, 0.0);
      for (int axis = 0; axis < 3; ++axis) q.vec()[axis] = source->around(0.0, 2.0);
      frame->T_map_camera.linear() = q.toRotationMatrix();
      break;
    }
    case 1: {
      const uint32_t axis = source->pick(3);
      frame->T_map_camera.translation()[axis] = source->specialNumber();
      break;
    }
    case 2:
      frame->p_map_base.x = source->specialNumber();
      break;
    default:  // any attitude, such as of a robot that fell
      frame->T_map_camera.rotate(
          Eigen::AngleAxisd(source->around(0.0, 3.2), Eigen::Vector3d::UnitX()));
  }
}

void spoilPredicate(ByteSource* source, core_msgs::Predicate* predicate) {
  switch (source->pick(5)) {
    case 0:
      predicate->spatial_operator = source->raw<uint8_t>();
      break;
    case 1:
      predicate->verdict = source->raw<uint8_t>();
      break;
    case 2:
      predicate->severity = source->raw<uint8_t>();
      break;
    case 3:
      predicate->radius_m = static_cast<float>(std::min(
          std::max(source->specialNumber(), -3e38), 3e38));  // NaN stays, infinities have their bit
      if (source->flag()) predicate->radius_m = source->raw<float>();
      break;
    default:
      predicate->exempt_instances.push_back(source->specialCount());
  }
}

}  // namespace

void spoilFrame(ByteSource* source, DrawnFrame* frame) {
  switch (source->pick(5)) {
    case 0:
      return spoilImage(source, &frame->depth);
    case 1:
      return spoilImage(source, &frame->labels);
    case 2:
      return spoilCamera(source, &frame->camera_info);
    case 3:
      return spoilLabelInfo(source, &frame->label_info);
    default:
      return spoilPose(source, frame);
  }
}

void spoilConstraints(ByteSource* source, core_msgs::SafetyConstraints* constraints) {
  switch (source->pick(4)) {
    case 0:
      constraints->image_stamp = drawStamp(source);
      break;
    case 1:
      constraints->instances_history_start = drawStamp(source);
      break;
    case 2:
      constraints->header.stamp = drawStamp(source);
      break;
    default:
      if (!constraints->predicates.empty())
        spoilPredicate(source, &constraints->predicates[source->pick(
                                   static_cast<uint32_t>(constraints->predicates.size()))]);
  }
}

}  // namespace fuzz
}  // namespace core_perception
