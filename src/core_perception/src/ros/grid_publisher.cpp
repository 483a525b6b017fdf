// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/ros/grid_publisher.h"

#include "core_perception/ros/conversions.h"

namespace core_perception {

GridPublisher::GridPublisher(ros::NodeHandle* nh, const std::string& topic, bool always,
                             double period_s)
    : always_(always), period_s_(period_s) {
  const ros::SubscriberStatusCallback onConnect = [this](const ros::SingleSubscriberPublisher&) {
    subscriber_is_new_ = true;
  };
  grid_pub_ =
      nh->advertise<nav_msgs::OccupancyGrid>(topic, 10, onConnect, {}, ros::VoidConstPtr(), always);
  update_pub_ = nh->advertise<map_msgs::OccupancyGridUpdate>(topic + "_updates", 10, onConnect);
}

bool GridPublisher::isWanted() const {
  return always_ || grid_pub_.getNumSubscribers() > 0 || update_pub_.getNumSubscribers() > 0;
}

void GridPublisher::publish(const nav_msgs::OccupancyGrid& grid) {
  if (isWholeDue(grid)) {
    grid_pub_.publish(grid);
    last_whole_ = grid.header.stamp;
    subscriber_is_new_ = false;
  } else {
    const map_msgs::OccupancyGridUpdate update = makeUpdate(last_, grid);
    if (!update.data.empty()) update_pub_.publish(update);
  }
  last_ = grid;
}

bool GridPublisher::isWholeDue(const nav_msgs::OccupancyGrid& grid) const {
  const nav_msgs::MapMetaData &now = grid.info, &before = last_.info;
  const bool same_place = now.width == before.width && now.height == before.height &&
                          now.origin.position.x == before.origin.position.x &&
                          now.origin.position.y == before.origin.position.y;
  const double age_s = (grid.header.stamp - last_whole_).toSec();
  return subscriber_is_new_ || !same_place || !(age_s >= 0.0 && age_s < period_s_);
}

}  // namespace core_perception
