// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <octomap/OcTree.h>

#include "core_perception/frame.h"
#include "core_perception/params.h"

namespace core_perception {
namespace bench {

/// Points of a frame within the z-depths of the parameters, in the fixed frame.
octomap::Pointcloud makeCloud(const Frame& frame, const RangeParams& range);

/// OctoMap's own insertion of such a cloud: rays are cast and free space is updated on the way.
/// @param discretize one ray a voxel instead of one a point.
void insertCloud(const octomap::Pointcloud& cloud, const Frame& frame, bool discretize,
                 octomap::OcTree* tree);

}  // namespace bench
}  // namespace core_perception
