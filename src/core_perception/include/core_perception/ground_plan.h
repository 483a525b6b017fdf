// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include "core_perception/ground_regions.h"
#include "core_perception/params.h"
#include "core_perception/tree_snapshot.h"

namespace core_perception {

/// Voxel layers that count for the 2-D map, both included.
struct HeightBand {
  int lowest = 0, highest = 0;
};

/// The whole map seen from above. Row-major as nav_msgs/OccupancyGrid.
struct GroundPlan {
  GridFrame frame;
  std::vector<int8_t> cells;  ///< 0 safe, 100 unsafe, -1 never seen
};

/// The decision of every column, as SafetyGrid has it for the window around the robot: votes by
/// `tau` and `column`, then regions of severity STOP over them. The initial disc is left out: what
/// is assumed is not seen. Empty for an empty map.
/// @throws std::length_error more than 16 million cells.
GroundPlan projectToGround(const TreeSnapshot& snapshot, const HeightBand& band,
                           const VoteParams& params, const std::vector<Region>& regions);

}  // namespace core_perception
