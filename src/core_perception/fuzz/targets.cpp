// SPDX-License-Identifier: BSD-3-Clause
#include "targets.h"

#include <boost/make_shared.hpp>
#include <random>

#include "../test/scene.h"
#include "wire.h"

namespace core_perception {
namespace fuzz {
namespace {

constexpr double kWindow_m = 8.0;  // a small grid, for more inputs a second

/// Core with some parameters anywhere within their bounds; core where they contradict each other.
SemanticMapParams drawParams(ByteSource* source) {
  ParamMap values;
  const auto put = [&](const char* key, double middle, double half) {
    if (source->flag()) values[key] = ParamValue::ofDouble(source->around(middle, half));
  };
  put("resolution_m", 0.3, 0.2);
  put("range_max_m", 6.0, 5.0);
  put("floor_z_m", 0.0, 1000.0);
  put("tau", 0.5, 0.49);
  put("depth_edge_ratio", 0.5, 0.5);
  put("match_distance_m", 1.0, 1.0);
  put("max_footprint_m", 1.1, 1.0);
  put("default_radius_m", 5.0, 5.0);
  put("mobile_half_life_s", 2.0, 2.0);
  put("mobile_release_s", 20.0, 20.0);
  put("mobile_slack_m", 1.0, 1.0);
  values["max_instances"] = ParamValue::ofInt(1 + static_cast<int>(source->pick(4)));
  values["local_floor"] = ParamValue::ofBool(source->flag());
  values["count_cap"] = ParamValue::ofInt(static_cast<int>(source->pick(12)));
  values["min_points"] = ParamValue::ofInt(1 + static_cast<int>(source->pick(8)));
  values["min_frames"] = ParamValue::ofInt(1 + static_cast<int>(source->pick(3)));
  values["release_frames"] = ParamValue::ofInt(1 + static_cast<int>(source->pick(3)));
  values["distance"] = ParamValue::ofString(source->flag() ? "centre" : "border");
  values["unknown_is_unsafe"] = ParamValue::ofBool(source->flag());
  try {
    return SemanticMapParams::fromMap(values);
  } catch (const ParameterError&) {
    return SemanticMapParams();
  }
}

Chain::Options drawOptions(ByteSource* source) {
  Chain::Options options;
  const uint32_t profile = source->pick(8);
  if (profile == 3 || profile == 4) options.params = makePaperParams();
  if (profile == 5) options.params.semantics = false;
  if (profile >= 6) options.params = drawParams(source);
  options.params.window_m = kWindow_m;
  if (options.params.unknown_is_unsafe && source->flag())
    options.params.window.keep_radius_m = kWindow_m;
  options.lockstep = source->flag();
  options.lens = static_cast<Lens>(source->pick(3));
  return options;
}

template <typename Message>
boost::shared_ptr<Message const> share(const Message& message) {
  return boost::make_shared<Message>(message);
}

FrameMessages shareAll(const DrawnFrame& frame) {
  FrameMessages messages;
  messages.depth = share(frame.depth);
  messages.labels = share(frame.labels);
  messages.camera_info = share(frame.camera_info);
  messages.label_info = share(frame.label_info);
  return messages;
}

ros::Time stampOf(uint32_t period) { return ros::Time(1 + 0.1 * period); }

Input drawInput(std::mt19937* random, size_t size) {
  Input input(size);
  for (uint8_t& byte : input) byte = static_cast<uint8_t>((*random)());
  return input;
}

}  // namespace

void runFrames(const uint8_t* data, size_t size, Tally* tally) {
  ByteSource source(data, size);
  Chain chain(drawOptions(&source), tally);
  const uint32_t n_steps = 1 + source.pick(4);
  uint32_t period = 0;
  for (uint32_t step = 0; step < n_steps; ++step) {
    const ros::Time stamp = stampOf(period);
    period += source.pick(8) == 7 ? 100 : 1;  // what moves fades in a gap
    DrawnFrame frame = drawFrame(&source, stamp);
    for (uint32_t n = source.pick(4) % 3; n > 0; --n) spoilFrame(&source, &frame);
    FrameMessages messages = shareAll(frame);
    if (source.pick(4) != 3) messages.constraints = share(drawConstraints(&source, stamp));
    if (source.flag()) {
      chain.enqueue(messages, frame.T_map_camera, frame.p_map_base, stamp);
    } else {
      chain.add(messages, frame.T_map_camera, frame.p_map_base);
    }
    if (source.pick(16) == 15) chain.clear();
  }
}

void runConstraints(const uint8_t* data, size_t size, Tally* tally) {
  ByteSource source(data, size);
  Chain chain(drawOptions(&source), tally);
  const DrawnFrame first = drawFrame(&source, stampOf(0));
  const uint32_t n_steps = 2 + source.pick(3);
  for (uint32_t step = 0; step < n_steps; ++step) {
    DrawnFrame frame = first;
    frame.depth.header.stamp = stampOf(step);
    core_msgs::SafetyConstraints constraints = drawConstraints(&source, stampOf(step));
    if (source.pick(3) == 2) spoilConstraints(&source, &constraints);
    FrameMessages messages = shareAll(frame);
    messages.constraints = share(constraints);
    chain.add(messages, frame.T_map_camera, frame.p_map_base);
  }
}

void runWire(const uint8_t* data, size_t size, Tally* tally) {
  ByteSource source(data, size);
  FrameMessages messages;
  messages.camera_info = readSection<sensor_msgs::CameraInfo>(&source);
  messages.label_info = readSection<core_msgs::LabelInfo>(&source);
  messages.constraints = readSection<core_msgs::SafetyConstraints>(&source);
  messages.depth = readSection<sensor_msgs::Image>(&source);
  messages.labels = readSection<sensor_msgs::Image>(&source);
  if (messages.camera_info == nullptr || messages.label_info == nullptr ||
      messages.depth == nullptr || messages.labels == nullptr)
    return;
  Chain chain(drawOptions(&source), tally);
  ByteSource none(nullptr, 0);
  DrawnFrame pose = drawFrame(&none, stampOf(0));
  chain.add(messages, pose.T_map_camera, pose.p_map_base);
  chain.enqueue(messages, pose.T_map_camera, pose.p_map_base, messages.depth->header.stamp);
}

namespace {

std::vector<NamedTarget> makeTargets() {
  std::mt19937 random(1);  // of the first inputs only
  std::vector<NamedTarget> targets = {{"frames", runFrames, {Input()}},
                                      {"constraints", runConstraints, {Input()}},
                                      {"wire", runWire, {}}};
  for (int i = 0; i < 60; ++i) {
    for (int k = 0; k < 2; ++k) targets[k].seeds.push_back(drawInput(&random, 20 + 6 * i));
    const Input drawn = drawInput(&random, 10 + 2 * i);
    ByteSource source(drawn.data(), drawn.size());
    const DrawnFrame frame = drawFrame(&source, stampOf(0));
    Input wire = makeWireInput(frame, drawConstraints(&source, stampOf(0)));
    wire.push_back(static_cast<uint8_t>(i));  // profile
    targets[2].seeds.push_back(wire);
  }
  return targets;
}

}  // namespace

const std::vector<NamedTarget>& targets() {
  static const std::vector<NamedTarget> all = makeTargets();
  return all;
}

const NamedTarget* findTarget(const std::string& name) {
  for (const NamedTarget& target : targets()) {
    if (target.name == name) return &target;
  }
  return nullptr;
}

}  // namespace fuzz
}  // namespace core_perception
