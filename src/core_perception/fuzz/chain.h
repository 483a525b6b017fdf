// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <string>

#include "core_perception/ros/frame_queue.h"
#include "draw_messages.h"
#include "map_checks.h"
#include "refusal_rules.h"

namespace core_perception {
namespace fuzz {

/// What came of the frames of one or more inputs.
struct Tally {
  int accepted = 0;
  std::map<std::string, int> refused;  ///< by FrameError::reason
};

/// The way of a frame through the node, without ROS: queue, conversion, map. Every frame is
/// checked: one that breaks a rule is refused with one diagnostic and changes nothing, any other
/// keeps the promises of checkMap.
class Chain {
 public:
  struct Options {
    SemanticMapParams params;
    bool lockstep = false;
    Lens lens = Lens::kRefused;
  };

  Chain(const Options& options, Tally* tally);

  /// Past the queue: whatever the stamps are.
  void add(const FrameMessages& messages, const Eigen::Isometry3d& T_map_camera,
           const Point2& p_map_base);
  /// Through the queue: none or more frames come out.
  void enqueue(const FrameMessages& messages, const Eigen::Isometry3d& T_map_camera,
               const Point2& p_map_base, const ros::Time& now);
  void clear();

 private:
  void checkStamps(const FrameMessages& messages) const;

  Options options_;
  Tally* tally_;
  SemanticMap map_;
  FrameQueue queue_;
  Rectifier rectifier_;
  uint64_t digest_;
};

constexpr double kSlop_s = 0.02;

}  // namespace fuzz
}  // namespace core_perception
