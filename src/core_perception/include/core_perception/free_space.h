// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <opencv2/core.hpp>

#include "core_perception/frame_votes.h"
#include "core_perception/local_floor.h"
#include "core_perception/projection.h"
#include "core_perception/vote_map.h"

namespace core_perception {

/// Takes an unsafe vote from every voxel of the band that the frame saw through: what stood there
/// has gone.
///
/// A voxel counts as seen through when its whole outline lies in the image and all of 5 x 5 pixels
/// spread over it have a depth beyond its far side. Voxels that hold points of this frame are left
/// alone. A pixel without depth says nothing by itself (the sky, a black or a shiny thing); it
/// counts as beyond where this frame saw floor and no obstacle in the voxel's column. A projective
/// test, without ray casting: its cost grows with the number of unsafe voxels, not of pixels.
/// What a moving thing left may also be cut by the border of the image, or lie beyond it, where all
/// floor of the column is in the image, this frame saw no obstacle there, and what it left reaches
/// down to the floor: near the camera the upper voxels of a person are above the image as long as
/// the robot stands still. A table at rest, or an arm over the floor, is not cleared so.
/// @param floor heights that the map's are above.
/// @returns number of voxels that lost a vote.
int clearSeenThrough(const cv::Mat& metres, const Projection& projection, const FrameVotes& votes,
                     const LocalFloor& floor, VoteMap* map);

/// Whether the voxel around this centre is seen through in the sense above.
/// @param no_depth_is_beyond whether pixels without depth (0) count as beyond.
/// @param outside_is_beyond whether those outside the image do.
bool isSeenThrough(const cv::Mat& metres, const Projection& projection,
                   const Eigen::Vector3d& centre, double resolution_m, bool no_depth_is_beyond,
                   bool outside_is_beyond = false);

}  // namespace core_perception
