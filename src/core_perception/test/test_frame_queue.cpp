// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <boost/make_shared.hpp>

#include "core_perception/ros/frame_queue.h"

namespace core_perception {
namespace {

constexpr double kSlop_s = 0.02;
constexpr int kSize = 5;

template <typename Message>
boost::shared_ptr<Message> at(double stamp_s) {
  auto message = boost::make_shared<Message>();
  message->header.stamp = ros::Time(stamp_s);
  return message;
}

void addLabels(FrameQueue* queue, double stamp_s) {
  queue->add(at<core_msgs::LabelInfo>(stamp_s));
  queue->add(at<sensor_msgs::Image>(stamp_s), false);
}

bool has(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

TEST(FrameQueue, says_which_topics_are_silent) {
  FrameQueue queue(false, kSlop_s, kSize);
  const std::string all = queue.describeMissing();
  for (const char* topic : {"camera/depth/image_raw", "camera/color/camera_info",
                            "segmentation/labels", "segmentation/label_info"}) {
    EXPECT_TRUE(has(all, topic)) << all;
  }
  queue.add(at<sensor_msgs::CameraInfo>(1.0));
  addLabels(&queue, 1.0);
  EXPECT_TRUE(has(queue.describeMissing(), "no depth image on /camera/depth/image_raw"));
  EXPECT_FALSE(has(queue.describeMissing(), "label"));
}

TEST(FrameQueue, says_how_far_stamps_are_apart) {
  FrameQueue queue(false, kSlop_s, kSize);
  queue.add(at<sensor_msgs::CameraInfo>(1.0));
  queue.add(at<sensor_msgs::Image>(1.0), true);
  addLabels(&queue, 1.05);
  EXPECT_TRUE(has(queue.describeMissing(), "0.020 s, of the labels: the nearest is 0.050 s away"))
      << queue.describeMissing();
  queue.add(at<sensor_msgs::Image>(1.04), true);
  EXPECT_EQ(queue.describeMissing(), "");
  EXPECT_EQ(queue.findComplete(ros::Time(2.0)).size(), 1u);
}

TEST(FrameQueue, says_that_labels_come_too_late_for_the_depth_it_keeps) {
  FrameQueue queue(false, kSlop_s, kSize);
  queue.add(at<sensor_msgs::CameraInfo>(1.0));
  for (int k = 0; k < 10; ++k) queue.add(at<sensor_msgs::Image>(1.0 + 0.1 * k), true);
  addLabels(&queue, 1.1);
  EXPECT_TRUE(has(queue.describeMissing(), "0.800 s after their depth image, and only the last 5"))
      << queue.describeMissing();
}

TEST(FrameQueue, camera_info_that_is_sent_once_survives_a_clock_that_goes_back) {
  FrameQueue queue(false, kSlop_s, kSize);
  queue.add(at<sensor_msgs::CameraInfo>(50.0));
  queue.add(at<sensor_msgs::Image>(60.0), true);
  queue.dropAfter(ros::Time(2.0));
  queue.add(at<sensor_msgs::Image>(2.0), true);
  addLabels(&queue, 2.0);
  ASSERT_EQ(queue.findComplete(ros::Time(3.0)).size(), 1u) << queue.describeMissing();
  // Of a lock-step world every message has its stamp.
  FrameQueue lockstep(true, kSlop_s, kSize);
  lockstep.add(at<sensor_msgs::CameraInfo>(50.0));
  lockstep.dropAfter(ros::Time(2.0));
  lockstep.add(at<sensor_msgs::Image>(2.0), true);
  addLabels(&lockstep, 2.0);
  lockstep.add(at<core_msgs::SafetyConstraints>(2.0));
  EXPECT_TRUE(lockstep.findComplete(ros::Time(3.0)).empty());
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
