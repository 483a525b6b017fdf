// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <octomap_msgs/BoundingBoxQuery.h>
#include <ros/ros.h>
#include <std_srvs/Empty.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/buffer.h>

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "core_perception/params.h"
#include "core_perception/rectification.h"
#include "core_perception/ros/frame_queue.h"
#include "core_perception/ros/grid_publisher.h"
#include "core_perception/ros/octomap_outputs.h"
#include "core_perception/semantic_map.h"

namespace core_perception {

/// Shell of SemanticMap: converts, calls, publishes. Driven by messages alone, in one thread; the
/// 3-D outputs have a thread of their own, which takes a snapshot under a lock.
class SemanticMapNode {
 public:
  /// @throws ParameterError map_file or map_dir cannot be used.
  explicit SemanticMapNode(const NodeParams& params);

 private:
  void advertise();
  void subscribe();
  template <typename Message>
  bool hasStamp(const Message& message, const char* what);
  void onDepth(const sensor_msgs::ImageConstPtr& depth);
  void onTf(const tf2_msgs::TFMessage& message, bool is_static);
  /// Stamps that go back by more mean that the clock was set back [s].
  double longestStepBack() const;
  /// Adds every complete frame whose pose is known.
  void processQueue();
  /// @returns false while the pose is not known yet.
  bool process(const FrameMessages& messages);
  bool lookUpPose(const std_msgs::Header& header, Frame* frame);
  void publish(const std_msgs::Header& header, const ros::Time& constraints_stamp);
  void publishDiagnostics(const ros::WallTimerEvent& event);
  /// Why no frame has come into the map lately, in words; empty while frames come.
  std::string describeWait();
  void reject(const std::string& reason, const std::string& detail);
  void flush(const ros::Time& stamp);
  void forget();
  bool onReset(std_srvs::Empty::Request& request, std_srvs::Empty::Response& response);
  bool onClearBox(octomap_msgs::BoundingBoxQuery::Request& request,
                  octomap_msgs::BoundingBoxQuery::Response& response);
  MapSnapshot takeSnapshot();
  uint64_t countChanges();

  NodeParams params_;
  ros::NodeHandle nh_;
  SemanticMap map_;
  std::mutex map_mutex_;  ///< of map_, taker_, map_stamp_ and n_changes_
  SnapshotTaker taker_;
  ros::Time map_stamp_;  ///< of the newest frame in the map
  uint64_t n_changes_ = 0;
  Rectifier rectifier_;
  FrameQueue queue_;
  tf2_ros::Buffer tf_;
  std::map<std::string, ros::Time> tf_stamps_;  ///< newest by child frame
  ros::Time last_depth_, last_frame_;
  ros::Time history_start_;  ///< stamp of the first frame since the map was empty; zero before it

  ros::Publisher grid_pub_, instances_pub_, diagnostics_pub_;
  std::unique_ptr<GridPublisher> probability_pub_, unsafe_pub_;
  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  std::vector<ros::WallTimer> timers_;

  uint64_t n_frames_ = 0, n_rejected_ = 0, n_dropped_ = 0, n_lost_told_ = 0;
  std::string last_rejection_;  ///< since the last diagnostics
  std::string tf_wait_;         ///< why the newest frame has no pose; empty when it has
  uint64_t n_frames_told_ = 0;  ///< frames when describeWait() was last called
  ros::WallTime last_progress_;
  double update_ms_ = 0.0, slowest_update_ms_ = 0.0, snapshot_ms_ = 0.0;
  std::unique_ptr<OctomapOutputs> outputs_;  ///< last: its thread ends before what it reads goes
};

}  // namespace core_perception
