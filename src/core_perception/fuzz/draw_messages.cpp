// SPDX-License-Identifier: BSD-3-Clause
#include "draw_messages.h"

#include <sensor_msgs/image_encodings.h>

#include <cmath>
#include <string>
#include <vector>

namespace core_perception {
namespace fuzz {
namespace {

namespace enc = sensor_msgs::image_encodings;

constexpr char kCameraFrame[] = "camera";
constexpr double kCameraHeight_m = 0.65;
constexpr double kPitch_rad = 0.25;  // camera of the demo robot, down

/// Camera looking ahead and down at a robot's pose; x, y in the fixed frame.
Eigen::Isometry3d makePose(double x_m, double y_m, double yaw_rad) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translate(Eigen::Vector3d(x_m, y_m, kCameraHeight_m));
  T.rotate(Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()));
  T.rotate(Eigen::AngleAxisd(kPitch_rad, Eigen::Vector3d::UnitY()));
  Eigen::Matrix3d optical;  // columns: right, down, forward in x forward, y left, z up
  optical << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  T.rotate(optical);
  return T;
}

struct Pixels {
  uint32_t width, height;
  std::vector<float> depth_m;
  std::vector<uint16_t> labels;
};

void paintFloor(const DrawnFrame& frame, Pixels* pixels) {
  const auto& K = frame.camera_info.K;
  const Eigen::Matrix3d R = frame.T_map_camera.linear();
  for (uint32_t v = 0; v < pixels->height; ++v) {
    for (uint32_t u = 0; u < pixels->width; ++u) {
      const Eigen::Vector3d ray = R * Eigen::Vector3d((u - K[2]) / K[0], (v - K[5]) / K[4], 1.0);
      const bool meets = ray.z() < 0.0;
      pixels->depth_m.push_back(meets ? static_cast<float>(-kCameraHeight_m / ray.z()) : 0.0f);
      pixels->labels.push_back(meets ? 1 : 0);
    }
  }
}

void paintBoxes(ByteSource* source, Pixels* pixels) {
  for (uint32_t n = source->pick(5); n > 0; --n) {
    const uint32_t u0 = source->pick(pixels->width), v0 = source->pick(pixels->height);
    const uint32_t u1 = std::min(pixels->width, u0 + 1 + source->pick(16));
    const uint32_t v1 = std::min(pixels->height, v0 + 1 + source->pick(16));
    const auto depth_m = static_cast<float>(source->around(3.5, 3.6));
    const auto label = static_cast<uint16_t>(source->pick(8));
    for (uint32_t v = v0; v < v1; ++v) {
      for (uint32_t u = u0; u < u1; ++u) {
        pixels->depth_m[v * pixels->width + u] = depth_m;
        pixels->labels[v * pixels->width + u] = label;
      }
    }
  }
}

void paintStrays(ByteSource* source, Pixels* pixels) {
  const auto n_pixels = static_cast<uint32_t>(pixels->depth_m.size());
  for (uint32_t n = source->pick(9); n > 0; --n) {
    const uint32_t i = source->pick(n_pixels), j = source->pick(n_pixels);
    pixels->depth_m[i] =
        source->flag() ? source->raw<float>() : static_cast<float>(source->specialNumber());
    pixels->labels[j] = source->raw<uint16_t>();
  }
}

template <typename T, typename Convert>
void encode(const Pixels& pixels, uint32_t padding, Convert convert, sensor_msgs::Image* image) {
  image->width = pixels.width;
  image->height = pixels.height;
  image->step = static_cast<uint32_t>((pixels.width + padding) * sizeof(T));
  image->data.assign(static_cast<size_t>(image->step) * pixels.height, 0xEE);
  for (uint32_t v = 0; v < pixels.height; ++v) {
    for (uint32_t u = 0; u < pixels.width; ++u) {
      const T value = convert(v * pixels.width + u);
      std::memcpy(&image->data[static_cast<size_t>(v) * image->step + u * sizeof(T)], &value,
                  sizeof(T));
    }
  }
}

void encodeDepth(const Pixels& pixels, bool millimetres, uint32_t padding,
                 sensor_msgs::Image* image) {
  if (!millimetres) {
    image->encoding = enc::TYPE_32FC1;
    encode<float>(pixels, padding, [&](size_t i) { return pixels.depth_m[i]; }, image);
    return;
  }
  image->encoding = enc::TYPE_16UC1;
  const auto toMillimetres = [&](size_t i) {
    const float mm = 1000.0f * pixels.depth_m[i];
    return static_cast<uint16_t>(mm >= 0.0f && mm < 65535.0f ? mm : 65535.0f);
  };
  encode<uint16_t>(pixels, padding, toMillimetres, image);
}

void drawLabelInfo(ByteSource* source, core_msgs::LabelInfo* info) {
  static const char* const kDefault[] = {"floor", "traffic_cone", "traffic_cone", "person"};
  for (uint16_t id = 1; id <= 4; ++id) {
    core_msgs::LabelClass label;
    label.id = id;
    label.class_name = kDefault[id - 1];
    info->labels.push_back(label);
  }
  for (uint32_t n = source->pick(4); n > 0; --n) {
    core_msgs::LabelClass label;
    label.id = static_cast<uint16_t>(4 + n);
    label.class_name = drawName(source);
    info->labels.push_back(label);
  }
  if (!source->flag()) info->classes_evaluated = {"floor", "traffic_cone", "person"};
}

core_msgs::Predicate drawPredicate(ByteSource* source) {
  core_msgs::Predicate predicate;
  predicate.spatial_operator = static_cast<uint8_t>(source->pick(4));
  predicate.class_name = drawName(source);
  predicate.verdict = static_cast<uint8_t>(source->pick(2));
  predicate.severity = static_cast<uint8_t>(source->pick(5) == 4 ? 1 : 0);
  predicate.radius_m = static_cast<float>(source->around(1.0, 1.0));
  for (uint32_t n = source->pick(4); n > 0; --n)
    predicate.exempt_instances.push_back(1 + source->pick(8));
  return predicate;
}

}  // namespace

std::string drawName(ByteSource* source) {
  static const std::vector<std::string> kNames = {"floor",
                                                  "traffic_cone",
                                                  "person",
                                                  "carpet",
                                                  "",
                                                  "\xff\xfe\x80",
                                                  "two\nlines",
                                                  std::string("nul\0inside", 10),
                                                  "traffic cone",
                                                  "TRAFFIC_CONE",
                                                  "/camera",
                                                  "UNKNOWN",
                                                  "a/b",
                                                  "%s%n%d",
                                                  std::string(300, 'x')};
  return kNames[source->pick(static_cast<uint32_t>(kNames.size()))];
}

ros::Time drawStamp(ByteSource* source) {
  static const uint32_t kParts[] = {0, 1, 2, 2147483647u, 2147483648u, 4294967294u, 4294967295u};
  static const uint32_t kNanoseconds[] = {0, 1, 500000000u, 999999999u, 1000000000u, 4294967295u};
  ros::Time stamp;  // filled as from the wire, where nothing is normalised
  stamp.sec = kParts[source->pick(7)];
  stamp.nsec = kNanoseconds[source->pick(6)];
  return stamp;
}

DrawnFrame drawFrame(ByteSource* source, const ros::Time& stamp) {
  static const uint32_t kWidths[] = {32, 1, 2, 7, 16, 33, 64, 512};
  static const uint32_t kHeights[] = {24, 1, 2, 5, 16, 17, 40, 64};
  Pixels pixels;
  pixels.width = kWidths[source->pick(8)];
  pixels.height = pixels.width > 64 ? 1 : kHeights[source->pick(8)];
  DrawnFrame frame;
  frame.camera_info.width = pixels.width;
  frame.camera_info.height = pixels.height;
  frame.camera_info.K = {0.55 * pixels.width,
                         0.0,
                         0.5 * pixels.width,
                         0.0,
                         1.18 * pixels.height,
                         0.5 * pixels.height,
                         0.0,
                         0.0,
                         1.0};
  const double reach_m = source->pick(4) == 3 ? 40.0 : 4.0;  // beyond what a rolling window keeps
  frame.p_map_base = {source->around(0.0, reach_m), source->around(0.0, reach_m)};
  frame.T_map_camera = makePose(frame.p_map_base.x, frame.p_map_base.y, source->around(0.0, 3.2));
  paintFloor(frame, &pixels);
  paintBoxes(source, &pixels);
  paintStrays(source, &pixels);
  const uint32_t padding = source->pick(3);
  encodeDepth(pixels, source->flag(), padding, &frame.depth);
  frame.labels.encoding = enc::MONO16;
  encode<uint16_t>(pixels, padding, [&](size_t i) { return pixels.labels[i]; }, &frame.labels);
  drawLabelInfo(source, &frame.label_info);
  frame.depth.header.frame_id = frame.labels.header.frame_id = frame.camera_info.header.frame_id =
      frame.label_info.header.frame_id = kCameraFrame;
  frame.depth.header.stamp = frame.labels.header.stamp = frame.camera_info.header.stamp =
      frame.label_info.header.stamp = stamp;
  return frame;
}

core_msgs::SafetyConstraints drawConstraints(ByteSource* source, const ros::Time& stamp) {
  core_msgs::SafetyConstraints constraints;
  constraints.header.stamp = constraints.image_stamp = stamp;
  constraints.instances_history_start = ros::Time(1);
  for (uint32_t n = 3 + source->pick(6); n > 0; --n)
    constraints.predicates.push_back(drawPredicate(source));
  return constraints;
}

}  // namespace fuzz
}  // namespace core_perception
