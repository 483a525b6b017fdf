// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <octomap/ColorOcTree.h>
#include <octomap/OcTree.h>
#include <octomap_msgs/Octomap.h>

#include <memory>
#include <sstream>
#include <string>

namespace core_perception {

/// What octomap_msgs/conversions.h does with a message, which Debian does not package: a full one
/// goes to the class of its id, a binary one to ColorOcTree for that id and to OcTree for every
/// other.
inline std::unique_ptr<octomap::AbstractOcTree> readMessage(const octomap_msgs::Octomap& message) {
  std::stringstream stream(std::string(message.data.begin(), message.data.end()));
  if (!message.binary) {
    std::unique_ptr<octomap::AbstractOcTree> tree(
        octomap::AbstractOcTree::createTree(message.id, message.resolution));
    if (tree != nullptr && !message.data.empty()) tree->readData(stream);
    return tree;
  }
  if (message.id == "ColorOcTree") {
    auto tree = std::make_unique<octomap::ColorOcTree>(message.resolution);
    if (!message.data.empty()) tree->readBinaryData(stream);
    return std::unique_ptr<octomap::AbstractOcTree>(std::move(tree));
  }
  auto tree = std::make_unique<octomap::OcTree>(message.resolution);
  if (!message.data.empty()) tree->readBinaryData(stream);
  return std::unique_ptr<octomap::AbstractOcTree>(std::move(tree));
}

/// MoveIt's planning scene takes messages of this id alone, whatever they hold.
inline bool isTakenByMoveIt(const octomap_msgs::Octomap& message) {
  return message.id == "OcTree" &&
         dynamic_cast<octomap::OcTree*>(readMessage(message).get()) != nullptr;
}

/// RViz's OctoMap displays look at the id, cast the tree to that class, and crash where it is
/// another.
template <typename Tree>
bool isTakenByRviz(const octomap_msgs::Octomap& message) {
  return message.id == Tree(0.1).getTreeType() &&
         dynamic_cast<Tree*>(readMessage(message).get()) != nullptr;
}

}  // namespace core_perception
