// SPDX-License-Identifier: BSD-3-Clause
#include <ros/ros.h>

#include <cstdio>
#include <opencv2/core.hpp>

#include "core_perception/exceptions.h"
#include "core_perception/ros/semantic_map_node.h"

int main(int argc, char** argv) {
  ros::init(argc, argv, "semantic_map");
  cv::setNumThreads(1);             // images this small are slower on several
  ros::NodeHandle private_nh("~");  // keeps the node alive until main returns
  try {
    XmlRpc::XmlRpcValue values;
    core_perception::ParamMap map;
    if (private_nh.getParam("", values)) map = core_perception::paramFromXmlRpc(values).members;
    core_perception::SemanticMapNode node(core_perception::NodeParams::fromMap(map));
    ros::spin();
  } catch (const core_perception::ParameterError& error) {
    std::fprintf(stderr, "%s: %s\n", ros::this_node::getName().c_str(), error.what());
    return 2;
  }
  return 0;
}
