// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include "draw_messages.h"

namespace core_perception {
namespace fuzz {

/// Section of a wire input: uint16 length, then a message as ROS serialises it. A section that
/// holds no whole message gives null, as roscpp drops such a message.
template <typename Message>
boost::shared_ptr<Message const> readSection(ByteSource* source);

/// The wire input that holds these messages.
std::vector<uint8_t> makeWireInput(const DrawnFrame& frame,
                                   const core_msgs::SafetyConstraints& constraints);

}  // namespace fuzz
}  // namespace core_perception
