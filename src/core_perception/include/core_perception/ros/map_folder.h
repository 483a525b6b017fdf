// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

namespace core_perception {

/// Where maps are saved: the parameter map_dir, or core_maps in ROS_HOME where it is empty. As
/// rospy and roslaunch: ROS_HOME, else ~/.ros. Only this default is made where it is missing.
std::string findMapFolder(const std::string& map_dir);

}  // namespace core_perception
