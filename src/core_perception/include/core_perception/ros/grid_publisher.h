// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <nav_msgs/OccupancyGrid.h>
#include <ros/ros.h>

#include <string>

namespace core_perception {

/// Publishes an occupancy grid on `topic`, whole, or what changed of it on `topic`_updates
/// (map_msgs/OccupancyGridUpdate), as RViz and the static layer of costmap_2d follow it.
class GridPublisher {
 public:
  /// @param always publish whether or not anybody listens, and latch.
  /// @param period_s longest time between whole grids, by their stamps [s]; 0: every grid is sent
  /// whole. A grid that moved, and the first after a new subscriber, always is.
  GridPublisher(ros::NodeHandle* nh, const std::string& topic, bool always, double period_s);

  bool isWanted() const;
  void publish(const nav_msgs::OccupancyGrid& grid);

 private:
  bool isWholeDue(const nav_msgs::OccupancyGrid& grid) const;

  bool always_;
  double period_s_;
  bool subscriber_is_new_ = true;
  nav_msgs::OccupancyGrid last_;  ///< what followers of both topics have
  ros::Time last_whole_;
  ros::Publisher grid_pub_, update_pub_;
};

}  // namespace core_perception
