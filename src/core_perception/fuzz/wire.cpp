// SPDX-License-Identifier: BSD-3-Clause
#include "wire.h"

#include <ros/serialization.h>

#include <boost/make_shared.hpp>

namespace core_perception {
namespace fuzz {
namespace {

/// Steps over a serialised message. roscpp makes room for as many elements as a length says before
/// it looks whether they are there, 4 GB if need be; that is not what is tested here.
class Walker {
 public:
  explicit Walker(const ByteSource& source) : source_(source) {}

  bool whole() const { return whole_; }
  void step(uint64_t n) {
    whole_ = whole_ && n <= source_.left();
    if (whole_) source_.skip(static_cast<size_t>(n));
  }
  /// Number of elements; each has at least one byte.
  uint32_t count() {
    if (source_.left() < sizeof(uint32_t)) whole_ = false;
    const auto n = whole_ ? source_.raw<uint32_t>() : 0;
    whole_ = whole_ && n <= source_.left();
    return whole_ ? n : 0;
  }
  void array(uint64_t element_size) { step(element_size * count()); }
  void header() {
    step(4 + 8);
    array(1);
  }

 private:
  ByteSource source_;
  bool whole_ = true;
};

void walk(const sensor_msgs::Image&, Walker* walker) {
  walker->header();
  walker->step(8);
  walker->array(1);
  walker->step(5);
  walker->array(1);
}

void walk(const sensor_msgs::CameraInfo&, Walker* walker) {
  walker->header();
  walker->step(8);
  walker->array(1);
  walker->array(8);
  walker->step(8 * (9 + 9 + 12) + 8 + 17);
}

void walk(const core_msgs::LabelInfo&, Walker* walker) {
  walker->header();
  for (uint32_t n = walker->count(); n > 0 && walker->whole(); --n) {
    walker->step(2);
    walker->array(1);
    walker->step(4);
  }
  for (uint32_t n = walker->count(); n > 0 && walker->whole(); --n) walker->array(1);
}

void walk(const core_msgs::SafetyConstraints&, Walker* walker) {
  walker->header();
  walker->step(16);
  for (uint32_t n = walker->count(); n > 0 && walker->whole(); --n) {
    walker->step(1);
    walker->array(1);
    walker->step(6);
    walker->array(4);
  }
  walker->step(8);
  for (uint32_t n = walker->count(); n > 0 && walker->whole(); --n) walker->array(1);
  walker->array(1);
  walker->array(1);
  walker->step(4);
}

template <typename Message>
void appendSection(const Message& message, std::vector<uint8_t>* bytes) {
  const uint32_t size = ros::serialization::serializationLength(message);
  if (size > 65535) return;  // such an input has no section for it
  bytes->push_back(static_cast<uint8_t>(size & 0xFF));
  bytes->push_back(static_cast<uint8_t>(size >> 8));
  bytes->resize(bytes->size() + size);
  ros::serialization::OStream stream(&(*bytes)[bytes->size() - size], size);
  ros::serialization::serialize(stream, message);
}

}  // namespace

template <typename Message>
boost::shared_ptr<Message const> readSection(ByteSource* source) {
  const size_t said = source->raw<uint16_t>();  // one by one: arguments have no order
  const size_t size = std::min(said, source->left());
  std::vector<uint8_t> bytes(source->at(), source->at() + size);
  source->skip(size);
  auto message = boost::make_shared<Message>();
  Walker walker(ByteSource(bytes.data(), bytes.size()));
  walk(*message, &walker);
  if (!walker.whole()) return nullptr;
  ros::serialization::IStream stream(bytes.data(), static_cast<uint32_t>(bytes.size()));
  try {
    ros::serialization::deserialize(stream, *message);
  } catch (const ros::serialization::StreamOverrunException&) {
    return nullptr;
  }
  return message;
}

std::vector<uint8_t> makeWireInput(const DrawnFrame& frame,
                                   const core_msgs::SafetyConstraints& constraints) {
  std::vector<uint8_t> bytes;
  appendSection(frame.camera_info, &bytes);
  appendSection(frame.label_info, &bytes);
  appendSection(constraints, &bytes);
  appendSection(frame.depth, &bytes);
  appendSection(frame.labels, &bytes);
  return bytes;
}

template sensor_msgs::ImageConstPtr readSection<sensor_msgs::Image>(ByteSource*);
template sensor_msgs::CameraInfoConstPtr readSection<sensor_msgs::CameraInfo>(ByteSource*);
template core_msgs::LabelInfoConstPtr readSection<core_msgs::LabelInfo>(ByteSource*);
template core_msgs::SafetyConstraintsConstPtr readSection<core_msgs::SafetyConstraints>(
    ByteSource*);

}  // namespace fuzz
}  // namespace core_perception
