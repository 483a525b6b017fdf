// SPDX-License-Identifier: BSD-3-Clause
#include "chain.h"

#include <cmath>

namespace core_perception {
namespace fuzz {
namespace {

constexpr int kQueueSize = 4;

double secondsOf(const ros::Time& stamp) { return stamp.sec + 1e-9 * stamp.nsec; }

}  // namespace

Chain::Chain(const Options& options, Tally* tally)
    : options_(options),
      tally_(tally),
      map_(options.params),
      queue_(options.lockstep, kSlop_s, kQueueSize),
      digest_(computeDigest(&map_)) {}

void Chain::add(const FrameMessages& messages, const Eigen::Isometry3d& T_map_camera,
                const Point2& p_map_base) {
  const char* broken = findBrokenRule(messages, T_map_camera, p_map_base, options_.lens);
  try {
    Frame frame = frameFromMessages(messages, options_.lens == Lens::kIgnored,
                                    options_.lens == Lens::kRectified ? &rectifier_ : nullptr);
    const Constraints constraints = constraintsFromMessage(messages.constraints);
    frame.T_map_camera = T_map_camera;
    frame.p_map_base = p_map_base;
    map_.update(frame, constraints);
  } catch (const FrameError& error) {
    ++tally_->refused[error.reason()];
    checkDiagnostic(error);
    require(computeDigest(&map_) == digest_, "a refused frame changes nothing");
    return;
  }
  if (broken != nullptr)
    throw BrokenPromise(std::string("a frame that breaks a rule was added: ") + broken);
  ++tally_->accepted;
  checkMap(&map_);
  digest_ = computeDigest(&map_);
}

void Chain::enqueue(const FrameMessages& messages, const Eigen::Isometry3d& T_map_camera,
                    const Point2& p_map_base, const ros::Time& now) {
  queue_.add(messages.depth, true);
  queue_.add(messages.camera_info);
  queue_.add(messages.labels, false);
  queue_.add(messages.label_info);
  if (messages.constraints != nullptr) queue_.add(messages.constraints);
  for (const FrameMessages& complete : queue_.findComplete(now)) {
    checkStamps(complete);
    add(complete, T_map_camera, p_map_base);
    queue_.dropUpTo(complete.depth->header.stamp);
  }
}

void Chain::checkStamps(const FrameMessages& messages) const {
  const ros::Time& stamp = messages.labels->header.stamp;
  require(messages.label_info->header.stamp == stamp, "labels and label_info have one stamp");
  if (!options_.lockstep) {
    const double apart_s = std::abs(secondsOf(messages.depth->header.stamp) - secondsOf(stamp));
    require(apart_s <= kSlop_s + 1e-5, "depth and labels are at most slop apart");
    return;
  }
  require(messages.depth->header.stamp == stamp && messages.camera_info->header.stamp == stamp &&
              messages.constraints != nullptr && messages.constraints->header.stamp == stamp,
          "all messages of a frame in lock-step have its stamp");
}

void Chain::clear() {
  map_.clear();
  require(map_.instances().empty() && map_.history_start_s() == 0.0, "a cleared map holds nothing");
  digest_ = computeDigest(&map_);
}

}  // namespace fuzz
}  // namespace core_perception
