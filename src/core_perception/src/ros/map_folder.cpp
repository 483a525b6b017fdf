// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/ros/map_folder.h"

#include <sys/stat.h>

#include <cstdlib>

namespace core_perception {
namespace {

std::string readEnvironment(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

std::string findMapFolder(const std::string& map_dir) {
  if (!map_dir.empty()) return map_dir;
  std::string home = readEnvironment("ROS_HOME");
  if (home.empty()) home = readEnvironment("HOME") + "/.ros";
  const std::string folder = home + "/core_maps";
  ::mkdir(home.c_str(), 0755);
  ::mkdir(folder.c_str(), 0755);
  return folder;
}

}  // namespace core_perception
