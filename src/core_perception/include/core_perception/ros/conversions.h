// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <core_msgs/InstanceArray.h>
#include <core_msgs/LabelInfo.h>
#include <core_msgs/SafetyConstraints.h>
#include <core_msgs/SafetyGrid.h>
#include <map_msgs/OccupancyGridUpdate.h>
#include <nav_msgs/OccupancyGrid.h>
#include <octomap_msgs/Octomap.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud2.h>
#include <xmlrpcpp/XmlRpcValue.h>

#include <string>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/ground_plan.h"
#include "core_perception/octomap_wire.h"
#include "core_perception/param_reader.h"
#include "core_perception/predicates.h"
#include "core_perception/rectification.h"
#include "core_perception/safety_grid.h"

namespace core_perception {

/// The messages of one frame.
struct FrameMessages {
  sensor_msgs::ImageConstPtr depth, labels;
  sensor_msgs::CameraInfoConstPtr camera_info;
  core_msgs::LabelInfoConstPtr label_info;
  core_msgs::SafetyConstraintsConstPtr constraints;  ///< null while none was received
};

/// Larger images are refused: no camera has them.
constexpr uint32_t kLargest_px = 16384;

/// Whether ROS can calculate with a stamp: not 0, below 2^31 s and normalised. Differences of
/// others may throw, and a message may have any bits.
bool isUsable(const ros::Time& stamp);

/// Frame id as tf2 takes it: recordings of the time of tf carry a leading slash.
std::string stripSlash(const std::string& frame_id);

/// Frame without its pose. The images share memory with the messages, which must outlive it, unless
/// they are rectified.
/// @param rectifier where given, distorted images are rectified by it and ignore_distortion means
/// nothing.
/// @throws FrameError image_encoding, image_size, frame_id, stamp_invalid, labels_invalid,
/// camera_invalid or distorted.
Frame frameFromMessages(const FrameMessages& messages, bool ignore_distortion,
                        Rectifier* rectifier = nullptr);

/// Intrinsics for an image of this size. A region of interest and binning are followed, and the
/// image must have just the size they give; without them K is scaled where camera_info speaks of
/// another size of the same shape. Of a distorted camera whose images are rectified already
/// (ignore_distortion) P counts, if it is filled in.
/// @throws FrameError camera_invalid or distorted.
Camera cameraFromMessage(const sensor_msgs::CameraInfo& info, int width_px, int height_px,
                         bool ignore_distortion);

/// Whether camera_info tells of a lens that bends lines.
bool hasDistortion(const sensor_msgs::CameraInfo& info);

/// @param rectified take P, which speaks of rectified images, instead of K.
Camera makeCamera(const sensor_msgs::CameraInfo& info, int width_px, int height_px, bool rectified);

/// @throws FrameError distorted for a model other than plumb_bob and rational_polynomial,
/// camera_invalid for what is no number.
Distortion distortionFromMessage(const sensor_msgs::CameraInfo& info);

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
                                       const TreeSnapshot& snapshot);
/// x, y, z of the centre of every unsafe voxel [m], as octomap_server's
/// octomap_point_cloud_centers.
sensor_msgs::PointCloud2 centersToMessage(const std_msgs::Header& header,
                                          const TreeSnapshot& snapshot);
nav_msgs::OccupancyGrid groundPlanToMessage(const GroundPlan& plan, const std_msgs::Header& header);
/// Smallest rectangle outside of which both grids are equal; they have the same size and origin.
map_msgs::OccupancyGridUpdate makeUpdate(const nav_msgs::OccupancyGrid& before,
                                         const nav_msgs::OccupancyGrid& after);

/// A parameter tree as the parameter server gives it.
ParamValue paramFromXmlRpc(const XmlRpc::XmlRpcValue& value);

}  // namespace core_perception
