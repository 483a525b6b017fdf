// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <core_msgs/InstanceArray.h>
#include <core_msgs/LabelInfo.h>
#include <core_msgs/SafetyConstraints.h>
#include <core_msgs/SafetyGrid.h>
#include <nav_msgs/OccupancyGrid.h>
#include <octomap_msgs/Octomap.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <xmlrpcpp/XmlRpcValue.h>

#include <string>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/octomap_wire.h"
#include "core_perception/param_reader.h"
#include "core_perception/predicates.h"
#include "core_perception/safety_grid.h"

namespace core_perception {

/// The messages of one frame.
struct FrameMessages {
  sensor_msgs::ImageConstPtr depth, labels;
  sensor_msgs::CameraInfoConstPtr camera_info;
  core_msgs::LabelInfoConstPtr label_info;
  core_msgs::SafetyConstraintsConstPtr constraints;  ///< null while none was received
};

/// Frame without its pose. The images share memory with the messages, which must outlive it.
/// @throws FrameError image_encoding, image_size, frame_id, camera_invalid or distorted.
Frame frameFromMessages(const FrameMessages& messages, bool ignore_distortion);

/// Intrinsics for an image of this size; K is scaled where camera_info speaks of another size of
/// the same shape.
/// @throws FrameError camera_invalid or distorted.
Camera cameraFromMessage(const sensor_msgs::CameraInfo& info, int width_px, int height_px,
                         bool ignore_distortion);

/// No constraints (null) are constraints not in force.
/// @throws FrameError constraints_invalid: unknown operator, verdict or severity, a radius that is
/// no radius, or exempt instances that have no number or no history to count by.
Constraints constraintsFromMessage(const core_msgs::SafetyConstraintsConstPtr& message);

core_msgs::SafetyGrid safetyGridToMessage(const SafetyGrid& grid, const std_msgs::Header& header,
                                          const ros::Time& constraints_stamp);
/// @param predicates in force, see SemanticMap::predicates.
core_msgs::InstanceArray instancesToMessage(const std::vector<HeldInstance>& instances,
                                            const std::vector<Predicate>& predicates,
                                            const std_msgs::Header& header);
/// P(unsafe) in percent; 100 under a region, -1 unknown.
nav_msgs::OccupancyGrid probabilityToMessage(const SafetyGrid& grid,
                                             const std_msgs::Header& header);
/// 0 safe, 100 unsafe, -1 unknown.
nav_msgs::OccupancyGrid decisionToMessage(const SafetyGrid& grid, const std_msgs::Header& header);
octomap_msgs::Octomap octomapToMessage(WireFormat format, const std_msgs::Header& header,
                                       SemanticOcTree* tree);

/// A parameter tree as the parameter server gives it.
ParamValue paramFromXmlRpc(const XmlRpc::XmlRpcValue& value);

}  // namespace core_perception
