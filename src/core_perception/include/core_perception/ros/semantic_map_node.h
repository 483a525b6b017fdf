// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <octomap_msgs/GetOctomap.h>
#include <ros/ros.h>
#include <std_srvs/Empty.h>
#include <tf2_msgs/TFMessage.h>
#include <tf2_ros/buffer.h>

#include <map>
#include <string>

#include "core_perception/params.h"
#include "core_perception/ros/frame_queue.h"
#include "core_perception/semantic_map.h"

namespace core_perception {

/// Shell of SemanticMap: converts, calls, publishes. Driven by messages alone; single-threaded.
class SemanticMapNode {
 public:
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
  void publishOctomaps(const ros::WallTimerEvent& event);
  void publishDiagnostics(const ros::WallTimerEvent& event);
  void reject(const std::string& reason, const std::string& detail);
  void flush(const ros::Time& stamp);
  void forget();
  bool onReset(std_srvs::Empty::Request& request, std_srvs::Empty::Response& response);
  bool onGetOctomap(WireFormat format, octomap_msgs::GetOctomap::Response* response);
  std_msgs::Header mapHeader() const;

  NodeParams params_;
  ros::NodeHandle nh_;
  SemanticMap map_;
  FrameQueue queue_;
  tf2_ros::Buffer tf_;
  std::map<std::string, ros::Time> tf_stamps_;  ///< newest by child frame
  ros::Time last_depth_, last_frame_;
  ros::Time history_start_;  ///< stamp of the first frame since the map was empty; zero before it

  ros::Publisher grid_pub_, instances_pub_, probability_pub_, unsafe_pub_, diagnostics_pub_;
  std::map<WireFormat, ros::Publisher> octomap_pubs_;
  std::map<WireFormat, uint64_t> octomap_versions_;
  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  std::vector<ros::WallTimer> timers_;

  uint64_t n_frames_ = 0, n_rejected_ = 0, n_dropped_ = 0;
  std::string last_rejection_;  ///< since the last diagnostics
  double update_ms_ = 0.0, slowest_update_ms_ = 0.0;
};

}  // namespace core_perception
