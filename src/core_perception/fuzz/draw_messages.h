// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Geometry>
#include <string>

#include "byte_source.h"
#include "core_perception/ros/conversions.h"

namespace core_perception {
namespace fuzz {

/// Messages that may still be changed, and the pose tf would give.
struct DrawnFrame {
  sensor_msgs::Image depth, labels;
  sensor_msgs::CameraInfo camera_info;
  core_msgs::LabelInfo label_info;
  Eigen::Isometry3d T_map_camera = Eigen::Isometry3d::Identity();
  Point2 p_map_base;
};

/// A name of a class or a frame: ordinary, empty, not UTF-8, with control characters, or long.
std::string drawName(ByteSource* source);

/// One of the numbers that arithmetic of stamps breaks on, or any.
ros::Time drawStamp(ByteSource* source);

/// A small well-formed frame: floor, a few boxes and stray pixels of any value, seen by a robot
/// near the origin. Depth is 32FC1 or 16UC1, sizes go down to 1x1 and up to 512x1.
DrawnFrame drawFrame(ByteSource* source, const ros::Time& stamp);

/// Constraints over the classes of drawFrame, well-formed.
core_msgs::SafetyConstraints drawConstraints(ByteSource* source, const ros::Time& stamp);

/// Spoils one field of one of the messages or the pose.
void spoilFrame(ByteSource* source, DrawnFrame* frame);
void spoilConstraints(ByteSource* source, core_msgs::SafetyConstraints* constraints);

}  // namespace fuzz
}  // namespace core_perception
