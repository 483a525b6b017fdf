// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/ros/frame_queue.h"

#include <ros/names.h>

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <iterator>
#include <limits>
#include <sstream>

namespace core_perception {
namespace {

template <typename Message>
void insert(const Message& message, size_t most, std::map<ros::Time, Message>* all) {
  if (!isUsable(message->header.stamp)) return;  // differences of such stamps throw
  (*all)[message->header.stamp] = message;
  while (all->size() > most) all->erase(all->begin());
}

template <typename Message>
Message findAt(const std::map<ros::Time, Message>& all, const ros::Time& stamp) {
  const auto it = all.find(stamp);
  return it == all.end() ? Message() : it->second;
}

/// The newest that is not newer than this.
template <typename Message>
Message findNewest(const std::map<ros::Time, Message>& all, const ros::Time& stamp) {
  const auto it = all.upper_bound(stamp);
  return it == all.begin() ? Message() : std::prev(it)->second;
}

std::string formatSeconds(double value_s) {
  std::ostringstream words;
  words << std::fixed << std::setprecision(3) << value_s;
  return words.str();
}

template <typename Map>
int eraseUpTo(const ros::Time& stamp, Map* all) {
  int n = 0;
  while (!all->empty() && all->begin()->first <= stamp) {
    all->erase(all->begin());
    ++n;
  }
  return n;
}

template <typename Map>
void eraseAfter(const ros::Time& stamp, Map* all) {
  all->erase(all->upper_bound(stamp), all->end());
}

}  // namespace

void FrameQueue::add(const sensor_msgs::ImageConstPtr& image, bool is_depth) {
  insert(image, size_, is_depth ? &depth_ : &labels_);
  (is_depth ? had_depth_ : had_labels_) = true;
}
void FrameQueue::add(const sensor_msgs::CameraInfoConstPtr& info) {
  insert(info, size_, &camera_info_);
  had_camera_info_ = true;
}
void FrameQueue::add(const core_msgs::LabelInfoConstPtr& info) {
  insert(info, size_, &label_info_);
  had_label_info_ = true;
}
void FrameQueue::add(const core_msgs::SafetyConstraintsConstPtr& constraints) {
  insert(constraints, size_, &constraints_);
}

sensor_msgs::ImageConstPtr FrameQueue::findDepth(const ros::Time& stamp) const {
  sensor_msgs::ImageConstPtr best;
  double smallest_s = slop_s_;
  for (const auto& depth : depth_) {
    const double difference_s = std::abs((depth.first - stamp).toSec());
    if (difference_s > smallest_s) continue;
    smallest_s = difference_s;
    best = depth.second;
  }
  return best;
}

bool FrameQueue::complete(const ros::Time& stamp, const ros::Time& now,
                          FrameMessages* frame) const {
  frame->labels = findAt(labels_, stamp);
  frame->label_info = findAt(label_info_, stamp);
  if (frame->labels == nullptr || frame->label_info == nullptr) return false;
  if (lockstep_) {
    frame->depth = findAt(depth_, stamp);
    frame->camera_info = findAt(camera_info_, stamp);
    frame->constraints = findAt(constraints_, stamp);
    return frame->depth != nullptr && frame->camera_info != nullptr &&
           frame->constraints != nullptr;
  }
  frame->depth = findDepth(stamp);
  frame->camera_info = camera_info_.empty() ? nullptr : camera_info_.rbegin()->second;
  frame->constraints = findNewest(constraints_, now);
  return frame->depth != nullptr && frame->camera_info != nullptr;
}

std::vector<FrameMessages> FrameQueue::findComplete(const ros::Time& now) const {
  std::vector<FrameMessages> frames;
  for (const auto& labels : labels_) {
    FrameMessages frame;
    if (complete(labels.first, now, &frame)) frames.push_back(frame);
  }
  return frames;
}

int FrameQueue::dropUpTo(const ros::Time& stamp) {
  const ros::Time labels_stamp = lockstep_ ? stamp : stamp + ros::Duration(slop_s_);
  eraseUpTo(labels_stamp, &labels_);
  eraseUpTo(labels_stamp, &label_info_);
  if (lockstep_) {
    eraseUpTo(stamp, &camera_info_);
    eraseUpTo(stamp, &constraints_);
  }
  return eraseUpTo(stamp, &depth_) - 1;
}

void FrameQueue::dropAfter(const ros::Time& stamp) {
  eraseAfter(stamp, &depth_);
  eraseAfter(stamp, &labels_);
  const sensor_msgs::CameraInfoConstPtr info =
      camera_info_.empty() ? nullptr : camera_info_.rbegin()->second;
  eraseAfter(stamp, &camera_info_);
  if (!lockstep_ && camera_info_.empty() && info != nullptr) camera_info_[stamp] = info;
  eraseAfter(stamp, &label_info_);
  eraseAfter(stamp, &constraints_);
}

std::string FrameQueue::describeNever() const {
  std::string words;
  const auto tell = [&words](bool had, const char* what, const char* topic) {
    if (had) return;
    words +=
        (words.empty() ? "no " : ", no ") + std::string(what) + " on " + ros::names::resolve(topic);
  };
  tell(had_depth_, "depth image", "camera/depth/image_raw");
  tell(had_camera_info_, "camera_info", "camera/color/camera_info");
  tell(had_labels_, "labels", "segmentation/labels");
  tell(had_label_info_, "label_info", "segmentation/label_info");
  return words;
}

std::string FrameQueue::describeMissing() const {
  const std::string never = describeNever();
  if (!never.empty()) return never;
  if (labels_.empty()) return "no new labels";
  const ros::Time stamp = labels_.rbegin()->first;
  FrameMessages frame;
  if (complete(stamp, stamp, &frame)) return "";
  if (lockstep_) return "other messages with the stamp of the labels have not come";
  if (frame.label_info == nullptr) return "no label_info has the stamp of the labels";
  if (depth_.empty()) return "no new depth image";
  if (depth_.begin()->first > stamp + ros::Duration(slop_s_)) {
    const double late_s = (depth_.rbegin()->first - stamp).toSec();
    return "labels come " + formatSeconds(late_s) +
           " s after their depth image, and only the last " + std::to_string(size_) +
           " are kept: raise queue_size";
  }
  double nearest_s = std::numeric_limits<double>::infinity();
  for (const auto& depth : depth_)
    nearest_s = std::min(nearest_s, std::abs((depth.first - stamp).toSec()));
  return "no depth image within slop_s, " + formatSeconds(slop_s_) +
         " s, of the labels: the nearest is " + formatSeconds(nearest_s) + " s away";
}

}  // namespace core_perception
