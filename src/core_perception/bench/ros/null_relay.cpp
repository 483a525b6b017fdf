// SPDX-License-Identifier: BSD-3-Clause
// What ROS alone costs: takes the two images of a frame and answers at once with an empty
// SafetyGrid of the size of the map's. Measured against by test/bench/grounding-ros.py; not
// installed.
#include <core_msgs/SafetyGrid.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include <map>

namespace {

using Images = std::map<ros::Time, sensor_msgs::ImageConstPtr>;

class NullRelay {
 public:
  NullRelay() {
    ros::NodeHandle private_nh("~");
    const int edge = private_nh.param("window_cells", 100);
    const auto queue_size = static_cast<uint32_t>(private_nh.param("queue_size", 60));
    const auto n = static_cast<size_t>(edge) * edge;
    grid_.width = grid_.height = static_cast<uint32_t>(edge);
    grid_.n_safe.resize(n);
    grid_.n_unsafe.resize(n);
    grid_.h_m.resize(n);
    grid_.state.resize(n);
    grid_.cause.resize(n);
    publisher_ = nh_.advertise<core_msgs::SafetyGrid>("safety_grid", 10);
    // As semantic_map listens.
    const auto hints = ros::TransportHints().tcpNoDelay();
    depth_sub_ =
        nh_.subscribe("camera/depth/image_raw", queue_size, &NullRelay::onDepth, this, hints);
    labels_sub_ =
        nh_.subscribe("segmentation/labels", queue_size, &NullRelay::onLabels, this, hints);
  }

 private:
  void onDepth(const sensor_msgs::ImageConstPtr& depth) { answer(depth, &depths_, &labels_); }
  void onLabels(const sensor_msgs::ImageConstPtr& labels) { answer(labels, &labels_, &depths_); }
  void answer(const sensor_msgs::ImageConstPtr& image, Images* own, Images* other) {
    const ros::Time stamp = image->header.stamp;
    if (other->count(stamp) == 0) {
      (*own)[stamp] = image;
      return;
    }
    for (Images* images : {own, other}) images->erase(images->begin(), images->upper_bound(stamp));
    grid_.header = image->header;
    publisher_.publish(grid_);
  }

  ros::NodeHandle nh_;
  core_msgs::SafetyGrid grid_;
  ros::Publisher publisher_;
  ros::Subscriber depth_sub_, labels_sub_;
  Images depths_, labels_;  ///< that wait for the other one
};

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "null_relay");
  NullRelay relay;
  ros::spin();
  return 0;
}
