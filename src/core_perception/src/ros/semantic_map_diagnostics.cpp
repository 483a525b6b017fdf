// SPDX-License-Identifier: BSD-3-Clause
#include <diagnostic_msgs/DiagnosticArray.h>

#include <cmath>

#include "core_perception/ros/semantic_map_node.h"

namespace core_perception {
namespace {

diagnostic_msgs::KeyValue makeEntry(const std::string& key, const std::string& value) {
  diagnostic_msgs::KeyValue entry;
  entry.key = key;
  entry.value = value;
  return entry;
}

}  // namespace

void SemanticMapNode::publishDiagnostics(const ros::WallTimerEvent&) {
  double slowest_snapshot_ms = 0.0;
  {
    const std::lock_guard<std::mutex> lock(map_mutex_);
    std::swap(slowest_snapshot_ms, snapshot_ms_);
  }
  diagnostic_msgs::DiagnosticArray array;
  array.header.stamp = ros::Time::now();
  diagnostic_msgs::DiagnosticStatus status;
  status.name = "semantic_map";
  status.hardware_id = nh_.getNamespace();
  const std::string wait = describeWait();
  status.level = wait.empty() ? diagnostic_msgs::DiagnosticStatus::OK
                              : diagnostic_msgs::DiagnosticStatus::WARN;
  status.message = wait.empty() ? "running" : wait;
  const RollingWindow::Status window = map_.windowStatus();
  const uint64_t n_lost = window.away.lost;
  if (!window.away.write_error.empty()) {
    status.level = diagnostic_msgs::DiagnosticStatus::WARN;
    status.message = "ground that left the window stays in memory: " + window.away.write_error;
  }
  if (n_lost != n_lost_told_) {
    status.level = diagnostic_msgs::DiagnosticStatus::ERROR;
    status.message = "ground is unknown again: " + window.away.read_error;
    n_lost_told_ = n_lost;
  }
  if (!last_rejection_.empty()) {
    status.level = diagnostic_msgs::DiagnosticStatus::ERROR;
    status.message = last_rejection_;
  }
  status.values = {makeEntry("frames", std::to_string(n_frames_)),
                   makeEntry("rejected", std::to_string(n_rejected_)),
                   makeEntry("dropped", std::to_string(n_dropped_)),
                   makeEntry("instances", std::to_string(map_.instances().size())),
                   makeEntry("instances_dropped", std::to_string(map_.countDroppedInstances())),
                   makeEntry("octree_nodes", std::to_string(map_.votes().tree().size())),
                   makeEntry("tiles_in_memory", std::to_string(window.tiles_in_memory)),
                   makeEntry("tiles_away", std::to_string(window.away.tiles)),
                   makeEntry("tiles_unwritten", std::to_string(window.away.unwritten)),
                   makeEntry("tiles_lost", std::to_string(n_lost)),
                   makeEntry("update_ms", std::to_string(update_ms_)),
                   makeEntry("slowest_update_ms", std::to_string(slowest_update_ms_)),
                   makeEntry("slowest_snapshot_ms", std::to_string(slowest_snapshot_ms))};
  array.status.push_back(status);
  diagnostics_pub_.publish(array);
  last_rejection_.clear();
  slowest_update_ms_ = 0.0;
}

std::string SemanticMapNode::describeWait() {
  constexpr double kQuiet_s = 2.0;  // slow segmenters need seconds
  const ros::WallTime now = ros::WallTime::now();
  if (last_progress_.isZero() || n_frames_ != n_frames_told_) last_progress_ = now;
  n_frames_told_ = n_frames_;
  const double quiet_s = (now - last_progress_).toSec();
  if (n_frames_ > 0 && quiet_s < kQuiet_s) return "";
  std::string why = queue_.describeMissing();
  if (why.empty() && !tf_wait_.empty()) why = "waiting for tf: " + tf_wait_;
  const std::string words = n_frames_ == 0
                                ? "no frame yet"
                                : "no frame for " + std::to_string(std::lround(quiet_s)) + " s";
  if (!why.empty()) ROS_WARN_THROTTLE(5.0, "semantic_map: %s: %s", words.c_str(), why.c_str());
  return why.empty() ? words : words + ": " + why;
}

}  // namespace core_perception
