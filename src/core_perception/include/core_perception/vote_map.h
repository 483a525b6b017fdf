// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <unordered_map>
#include <vector>

#include "core_perception/frame_votes.h"
#include "core_perception/params.h"
#include "core_perception/semantic_octree.h"
#include "core_perception/vote_rule.h"

namespace core_perception {

/// A column of the 2-D map.
struct Column {
  Counts counts;
  uint16_t cause = kNoCause;  ///< of the newest unsafe vote
  uint32_t cause_frame = 0;
  uint32_t derived_frame = 0;
};

/// The 3-D map of votes and the 2-D counts that follow from it. The votes of the voxels of the
/// height band are kept a second time beside their columns, where they are found without a descent
/// of the tree.
///
/// A column takes the voxels that reach into the height band: their sum (`sum`, as [CORE]) or the
/// worst of them
/// (`worst`). Voxels above, such as a ceiling or a lamp, do not mark the floor below.
class VoteMap {
 public:
  VoteMap(double resolution_m, const RangeParams& range, const VoteParams& vote);

  /// Adds what one frame saw: one tree update a voxel.
  void add(const FrameVotes& votes);
  /// Takes one unsafe vote from a voxel of the band; a voxel left without votes is removed.
  void contradictVoxel(const VoxelIndex& voxel);
  /// Removes the voxels whose centre lies in the closed box; returns how many.
  int clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m);
  /// Takes the votes of another tree of the same resolution, within the span of this map. Counts
  /// are brought under the cap in proportion.
  /// @param with_safe false: only voxels that are not safe, with their unsafe votes alone.
  /// @param cause of what is unsafe by it.
  void load(const SemanticOcTree& saved, bool with_safe, uint16_t cause);
  /// Column or nullptr when nothing was ever seen there.
  const Column* find(int x, int y) const;
  /// Lowest and highest voxel of the band.
  int bandMin() const { return band_min_; }
  int bandMax() const { return band_max_; }
  /// Votes of a voxel; empty where nothing was seen.
  Counts counts(const VoxelIndex& voxel) const;
  SemanticOcTree& tree() { return tree_; }
  /// Grows with every change.
  uint64_t version() const { return version_; }
  void clear();

 private:
  static constexpr int kTile = 32;
  /// kTile x kTile columns, and the voxels of the band of each.
  struct Tile {
    std::vector<Column> columns;
    std::vector<Counts> band;
  };
  /// A column of a tile; null pointers where there is no tile.
  struct Place {
    Column* column = nullptr;
    Counts* band = nullptr;  ///< from the lowest voxel of the band on
  };

  bool isInBand(int z) const { return z >= band_min_ && z <= band_max_; }
  Place findPlace(int x, int y) const;
  Place touchPlace(int x, int y);
  void addToVoxel(const VoxelIndex& voxel, const VoxelTally& tally);
  void addToColumn(const VoxelTally& tally, bool metric, bool unsafe, const Place& place);
  void setVoxel(const VoxelIndex& voxel, const Counts& counts);
  void derive(const Place& place) const;

  VoteParams vote_;
  bool by_pixel_, by_sum_;
  int tree_min_, tree_max_, band_min_, band_max_;
  SemanticOcTree tree_;
  std::unordered_map<uint64_t, std::unique_ptr<Tile>> tiles_;
  mutable uint64_t last_tile_key_ = 0;
  mutable Tile* last_tile_ = nullptr;
  std::vector<Place> derived_;  ///< columns to derive at the end of a frame
  uint32_t frame_ = 0;
  uint64_t version_ = 0;
};

}  // namespace core_perception
