// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <string>
#include <vector>

#include "core_perception/ros/conversions.h"

namespace core_perception {

/// Puts the messages of one instant together. Free of ROS time: the time now is an argument.
///
/// Lock-step: a frame is complete when depth, camera_info, labels, label_info and constraints all
/// have its stamp. Otherwise: labels and label_info have one stamp, the nearest depth is at most
/// slop away, camera_info is the newest, and the constraints are the newest that hold at the given
/// time; they may be missing.
class FrameQueue {
 public:
  FrameQueue(bool lockstep, double slop_s, int size)
      : lockstep_(lockstep), slop_s_(slop_s), size_(size) {}

  /// A message whose stamp is not usable (see isUsable) is left out.
  void add(const sensor_msgs::ImageConstPtr& image, bool is_depth);
  void add(const sensor_msgs::CameraInfoConstPtr& info);
  void add(const core_msgs::LabelInfoConstPtr& info);
  void add(const core_msgs::SafetyConstraintsConstPtr& constraints);

  /// Complete frames, oldest first. They stay in the queue until dropped.
  std::vector<FrameMessages> findComplete(const ros::Time& now) const;
  /// Drops everything up to this stamp (labels within slop of it too), the constraints in force
  /// apart.
  /// @returns number of depth images dropped that were older.
  int dropUpTo(const ros::Time& stamp);
  /// Drops what is newer: it was sent before the clock was set back. Without lock-step the newest
  /// camera_info stays: some drivers send it once.
  void dropAfter(const ros::Time& stamp);
  /// What the newest labels wait for, in words; empty where nothing is missing.
  std::string describeMissing() const;

 private:
  template <typename Message>
  using ByStamp = std::map<ros::Time, Message>;

  sensor_msgs::ImageConstPtr findDepth(const ros::Time& stamp) const;
  std::string describeNever() const;
  bool complete(const ros::Time& stamp, const ros::Time& now, FrameMessages* frame) const;

  bool lockstep_;
  double slop_s_;
  size_t size_;
  bool had_depth_ = false, had_labels_ = false, had_camera_info_ = false, had_label_info_ = false;
  ByStamp<sensor_msgs::ImageConstPtr> depth_, labels_;
  ByStamp<sensor_msgs::CameraInfoConstPtr> camera_info_;
  ByStamp<core_msgs::LabelInfoConstPtr> label_info_;
  ByStamp<core_msgs::SafetyConstraintsConstPtr> constraints_;
};

}  // namespace core_perception
