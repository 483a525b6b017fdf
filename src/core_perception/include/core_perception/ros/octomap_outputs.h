// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <core_msgs/SaveMap.h>
#include <octomap_msgs/GetOctomap.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include <functional>
#include <string>
#include <vector>

#include "core_perception/ground_plan.h"
#include "core_perception/octomap_wire.h"
#include "core_perception/params.h"

namespace core_perception {

/// The map at one instant, as far as its 3-D outputs need it.
struct MapSnapshot {
  std_msgs::Header header;
  TreeSnapshot tree;
  HeightBand band;
  std::vector<Region> regions;
};

/// What octomap_server would offer, and semantic_map/save. Works in a thread of its own: frames
/// wait only while a snapshot is taken, not while it is turned into messages or written to disk.
class OctomapOutputs {
 public:
  using TakeSnapshot = std::function<MapSnapshot()>;
  /// Grows with every change of what a snapshot holds; > 0 once it holds anything.
  using CountChanges = std::function<uint64_t()>;

  /// Both functions are called from the other thread.
  OctomapOutputs(const NodeParams& params, const TakeSnapshot& takeSnapshot,
                 const CountChanges& countChanges);
  ~OctomapOutputs();

 private:
  struct Topic {
    ros::Publisher publisher;
    std::function<void(const MapSnapshot&, ros::Publisher*)> send;
    uint64_t n_changes;  ///< when it was published last
  };

  template <typename Message, typename MakeMessage>
  void advertise(const std::string& topic, MakeMessage makeMessage);
  void publish(const ros::WallTimerEvent& event);
  bool onSave(const std::string& file, core_msgs::SaveMap::Response* response);

  NodeParams params_;
  TakeSnapshot takeSnapshot_;
  CountChanges countChanges_;
  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  std::vector<Topic> topics_;
  std::vector<ros::ServiceServer> services_;
  ros::WallTimer timer_;
  ros::AsyncSpinner spinner_;
};

}  // namespace core_perception
