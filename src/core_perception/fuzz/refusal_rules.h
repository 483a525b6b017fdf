// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Geometry>

#include "core_perception/ros/conversions.h"

namespace core_perception {
namespace fuzz {

/// What is done about distortion in camera_info.
enum class Lens { kRefused, kIgnored, kRectified };

/// The rule of those that a reader of the message definitions can state which these messages break:
/// then the frame must be refused; nullptr for none. Written apart from the code under test, by the
/// definitions alone. A frame that breaks none may still be refused (a view too wide, a pose too
/// far out).
const char* findBrokenRule(const FrameMessages& messages, const Eigen::Isometry3d& T_map_camera,
                           const Point2& p_map_base, Lens lens);

}  // namespace fuzz
}  // namespace core_perception
