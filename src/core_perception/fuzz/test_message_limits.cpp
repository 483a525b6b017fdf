// SPDX-License-Identifier: BSD-3-Clause
/// What fuzzing and attacks by hand found, one test each; and how long the largest frame may take.
#include <gtest/gtest.h>
#include <sensor_msgs/image_encodings.h>

#include <boost/make_shared.hpp>
#include <cstring>
#include <ctime>
#include <limits>

#include "core_perception/ros/frame_queue.h"
#include "draw_messages.h"
#include "map_checks.h"

namespace core_perception {
namespace fuzz {
namespace {

ros::Time makeStamp(uint32_t sec, uint32_t nsec) {  // as from the wire: not normalised
  ros::Time stamp;
  stamp.sec = sec;
  stamp.nsec = nsec;
  return stamp;
}

DrawnFrame makeFrame(const ros::Time& stamp = ros::Time(1)) {
  ByteSource none(nullptr, 0);
  return drawFrame(&none, stamp);
}

core_msgs::Predicate makeRule(uint8_t spatial_operator, const std::string& class_name) {
  core_msgs::Predicate rule;
  rule.spatial_operator = spatial_operator;
  rule.class_name = class_name;
  rule.verdict = core_msgs::Predicate::UNSAFE;
  return rule;
}

FrameMessages share(const DrawnFrame& frame, const core_msgs::SafetyConstraints& constraints) {
  FrameMessages messages;
  messages.depth = boost::make_shared<sensor_msgs::Image>(frame.depth);
  messages.labels = boost::make_shared<sensor_msgs::Image>(frame.labels);
  messages.camera_info = boost::make_shared<sensor_msgs::CameraInfo>(frame.camera_info);
  messages.label_info = boost::make_shared<core_msgs::LabelInfo>(frame.label_info);
  messages.constraints = boost::make_shared<core_msgs::SafetyConstraints>(constraints);
  return messages;
}

/// Reason the frame is refused for, with its diagnostic checked; empty when it is added.
std::string findReason(const DrawnFrame& drawn, const core_msgs::SafetyConstraints& constraints,
                       const SemanticMapParams& params = SemanticMapParams()) {
  SemanticMap map(params);
  try {
    const FrameMessages messages = share(drawn, constraints);
    Frame frame = frameFromMessages(messages, false);
    frame.T_map_camera = drawn.T_map_camera;
    frame.p_map_base = drawn.p_map_base;
    map.update(frame, constraintsFromMessage(messages.constraints));
    checkMap(&map);
  } catch (const FrameError& error) {
    checkDiagnostic(error);
    return error.reason();
  }
  return "";
}

std::string findReason(const DrawnFrame& drawn) {
  return findReason(drawn, core_msgs::SafetyConstraints());
}

TEST(MessageLimits, stamps_any_distance_apart_pass_the_queue) {
  const ros::Time stamps[] = {makeStamp(0, 1),           makeStamp(1, 0),
                              makeStamp(2147483647u, 0), makeStamp(2147483648u, 0),
                              makeStamp(3000000000u, 0), makeStamp(4294967295u, 999999999u),
                              makeStamp(1, 4294967295u), makeStamp(4294967295u, 4294967295u)};
  for (const bool lockstep : {false, true}) {
    for (const ros::Time& one : stamps) {
      for (const ros::Time& other : stamps) {
        FrameQueue queue(lockstep, 0.02, 4);
        const FrameMessages a = share(makeFrame(one), core_msgs::SafetyConstraints());
        const FrameMessages b = share(makeFrame(other), core_msgs::SafetyConstraints());
        queue.add(a.depth, true);
        queue.add(a.camera_info);
        queue.add(b.labels, false);
        queue.add(b.label_info);
        EXPECT_NO_THROW({
          for (const FrameMessages& complete : queue.findComplete(other))
            queue.dropUpTo(complete.depth->header.stamp);
          queue.dropAfter(other);
        }) << one.sec
           << "." << one.nsec << " and " << other.sec << "." << other.nsec;
      }
    }
  }
}

TEST(MessageLimits, a_stamp_ros_cannot_calculate_with_is_refused) {
  for (const ros::Time& stamp : {makeStamp(0, 0), makeStamp(2147483648u, 0),
                                 makeStamp(4294967295u, 999999999u), makeStamp(1, 1000000000u)})
    EXPECT_EQ(findReason(makeFrame(stamp)), "stamp_invalid") << stamp.sec << "." << stamp.nsec;
  EXPECT_EQ(findReason(makeFrame(makeStamp(2147483647u, 999999999u))), "");
}

TEST(MessageLimits, text_from_outside_stays_in_one_line_of_the_diagnostic) {
  for (const std::string& text : {std::string("16UC1\n"), std::string("\x1b[31m"),
                                  std::string("\xff\xfe"), std::string(1000000, 'x')}) {
    DrawnFrame encoding = makeFrame(), frame_id = makeFrame(), labels = makeFrame();
    encoding.depth.encoding = text;
    frame_id.labels.header.frame_id = text;
    labels.label_info.labels[1].class_name = text.substr(0, 100);
    labels.label_info.labels[2].id = labels.label_info.labels[1].id;
    EXPECT_EQ(findReason(encoding), "image_encoding");
    EXPECT_EQ(findReason(frame_id), "frame_id");
    EXPECT_EQ(findReason(labels), "labels_invalid");
    core_msgs::SafetyConstraints constraints;
    constraints.predicates.push_back(makeRule(9, text));
    EXPECT_EQ(findReason(makeFrame(), constraints), "constraints_invalid");
  }
}

TEST(MessageLimits, intrinsics_of_another_camera_are_refused) {
  DrawnFrame frame = makeFrame();
  EXPECT_EQ(findReason(frame), "");
  frame.camera_info.header.frame_id = "another_camera";
  EXPECT_EQ(findReason(frame), "frame_id");
  // As old recordings and careless drivers have them.
  for (const std::string& same : {std::string(), "/" + frame.depth.header.frame_id}) {
    frame.camera_info.header.frame_id = same;
    EXPECT_EQ(findReason(frame), "") << same;
  }
}

TEST(MessageLimits, intrinsics_that_are_no_pinhole_camera_are_refused) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const double nothing = std::numeric_limits<double>::quiet_NaN();
  for (const size_t focal : {0u, 4u}) {
    for (const double value : {0.0, -0.0, -1.0, -6553.6, -1e300, 1e-300, kInfinity, nothing}) {
      DrawnFrame frame = makeFrame();
      frame.camera_info.K[focal] = value;
      EXPECT_EQ(findReason(frame), "camera_invalid") << "K[" << focal << "] = " << value;
    }
  }
  for (const size_t centre : {2u, 5u}) {
    for (const double value : {-1e300, 1e300, -500.0, 500.0, kInfinity, -kInfinity, nothing}) {
      DrawnFrame frame = makeFrame();
      frame.camera_info.K[centre] = value;
      EXPECT_EQ(findReason(frame), "camera_invalid") << "K[" << centre << "] = " << value;
    }
  }
}

TEST(MessageLimits, names_that_would_fill_the_memory_are_refused) {
  DrawnFrame frame = makeFrame();
  frame.label_info.labels[0].class_name = std::string(128, 'x');
  EXPECT_EQ(findReason(frame), "");
  frame.label_info.labels[0].class_name += "x";
  EXPECT_EQ(findReason(frame), "labels_invalid");
  core_msgs::SafetyConstraints constraints;
  constraints.predicates.push_back(makeRule(core_msgs::Predicate::NEAR, std::string(129, 'x')));
  EXPECT_EQ(findReason(makeFrame(), constraints), "constraints_invalid");
}

TEST(MessageLimits, more_rules_than_a_reasoner_states_are_refused) {
  core_msgs::SafetyConstraints constraints;
  constraints.instances_history_start = ros::Time(1);
  constraints.predicates.assign(256, makeRule(core_msgs::Predicate::BETWEEN, "traffic_cone"));
  EXPECT_EQ(findReason(makeFrame(), constraints), "");
  constraints.predicates.push_back(makeRule(core_msgs::Predicate::ON, "floor"));
  EXPECT_EQ(findReason(makeFrame(), constraints), "constraints_invalid");
  constraints.predicates.assign(1, makeRule(core_msgs::Predicate::AROUND, "traffic_cone"));
  constraints.predicates[0].exempt_instances.assign(10001, 1);
  EXPECT_EQ(findReason(makeFrame(), constraints), "constraints_invalid");
  constraints.predicates[0].exempt_instances.clear();
  for (const float radius_m : {20.5f, 1e38f, -0.1f, std::numeric_limits<float>::infinity(),
                               std::numeric_limits<float>::quiet_NaN()}) {
    constraints.predicates[0].radius_m = radius_m;
    EXPECT_EQ(findReason(makeFrame(), constraints), "constraints_invalid") << radius_m;
  }
  constraints.predicates[0].radius_m = 20.0f;
  EXPECT_EQ(findReason(makeFrame(), constraints), "");
}

/// 500 x 320 pixels of floor, every one with a label of its own as far as there are any.
DrawnFrame makeLabelNoise() {
  DrawnFrame frame = makeFrame();
  frame.camera_info.width = frame.depth.width = frame.labels.width = 500;
  frame.camera_info.height = frame.depth.height = frame.labels.height = 320;
  frame.camera_info.K = {274.9, 0.0, 250.0, 0.0, 376.7, 160.0, 0.0, 0.0, 1.0};
  frame.depth.encoding = frame.labels.encoding = sensor_msgs::image_encodings::MONO16;
  frame.depth.step = frame.labels.step = 1000;
  frame.depth.data.assign(320000, 0x0C);  // 3.084 m
  frame.labels.data.resize(320000);
  for (uint32_t i = 0; i < 160000; ++i) {
    const auto label = static_cast<uint16_t>(i * 40503u);
    std::memcpy(&frame.labels.data[2 * i], &label, 2);
  }
  frame.label_info.labels.clear();
  for (uint32_t id = 1; id < 65536; ++id) {
    core_msgs::LabelClass label;
    label.id = static_cast<uint16_t>(id);
    label.class_name = "class_" + std::to_string(id % 1000);
    frame.label_info.labels.push_back(label);
  }
  return frame;
}

TEST(MessageLimits, the_worst_labels_and_rules_that_are_allowed_take_less_than_two_seconds) {
  core_msgs::SafetyConstraints constraints;
  constraints.image_stamp = ros::Time(1);
  for (int i = 0; i < 256; ++i) {
    constraints.predicates.push_back(makeRule(static_cast<uint8_t>(i % 4), "class_1"));
    constraints.predicates.back().class_name += std::to_string(i);
    constraints.predicates.back().radius_m = 20.0f;
  }
  const DrawnFrame frame = makeLabelNoise();
  SemanticMapParams image;
  image.operators = "image";
  for (const SemanticMapParams& params : {SemanticMapParams(), image}) {
    const std::clock_t start = std::clock();
    EXPECT_EQ(findReason(frame, constraints, params), "");
    const double cpu_s = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
#ifdef NDEBUG
    EXPECT_LT(cpu_s, 2.0) << params.operators;
#else
    EXPECT_LT(cpu_s, 60.0) << params.operators;  // with sanitizers
#endif
  }
}

}  // namespace
}  // namespace fuzz
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
