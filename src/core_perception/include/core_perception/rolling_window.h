// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <set>
#include <vector>

#include "core_perception/instance_memory.h"
#include "core_perception/params.h"
#include "core_perception/tile_store.h"
#include "core_perception/vote_map.h"

namespace core_perception {

/// Keeps the map in memory only around the robot.
///
///     ground        stays while any of its tile (VoteMap::kTile columns square) lies within
///                   R = max(keep_radius_m, reach of the camera or of the published window), and up
///                   to kSlackTiles tiles farther
///     instances     stay, by whole clusters, while the cluster's bounding box lies within R +
///     those tiles
///                   + the largest radius of a region: none that reaches over ground in memory goes
///
/// outside "drop": what leaves is unknown when the robot comes back. "disk": tiles go to a
/// TileStore and come back bit for bit before anything is added to them or asked of them; instances
/// that leave are put aside in memory, so that no hazard hangs on a disk. A tile that is lost there
/// is unknown. Work is spread over frames, save where the robot has jumped.
class RollingWindow {
 public:
  struct Status {
    size_t tiles_in_memory = 0;
    TileStore::Status away;
  };

  /// @throws ParameterError outside is "disk" and tile_dir cannot be written to.
  explicit RollingWindow(const SemanticMapParams& params);

  /// To be called before anything is added to the map.
  /// @param reach_m how far from the robot this frame may add or take votes.
  /// @param region_radius_m largest radius of a region in force.
  /// @returns whether ground was forgotten.
  bool follow(const Point2& robot, double reach_m, double region_radius_m, VoteMap* votes,
              InstanceMemory* memory);
  /// Forgets the tiles away that a box reaches into, whole; returns how many.
  int clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m);
  void clear();
  Status status() const;

 private:
  double distanceTo(const CellIndex& tile, const Point2& robot) const;
  void plan(const Point2& robot, double radius_m, const VoteMap& votes);
  bool bringBack(const Point2& robot, double needed_m, VoteMap* votes);
  bool sendAway(VoteMap* votes);

  WindowParams params_;
  double tile_m_, published_m_, gap_m_;
  std::unique_ptr<TileStore> store_;  ///< null with outside "drop"
  bool planned_ = false;
  Point2 planned_at_;
  double planned_radius_m_ = 0.0;
  std::vector<CellIndex> leaving_, coming_;  ///< nearest last
  std::set<CellIndex> read_ahead_;
  size_t n_in_memory_ = 0;
  int budget_ = 0;  ///< voxels that may still be moved in this frame
};

}  // namespace core_perception
