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

/// The 3-D map of votes and the 2-D counts that follow from it.
///
/// A column takes the voxels that reach into the height band: their sum (`sum`, as [CORE]) or the
/// worst of them
/// (`worst`). Voxels above, such as a ceiling or a lamp, do not mark the floor below.
class VoteMap {
 public:
  VoteMap(double resolution_m, const RangeParams& range, const VoteParams& vote);

  /// Adds what one frame saw: one tree update a voxel.
  void add(const FrameVotes& votes);
  /// Takes one unsafe vote from a voxel; a voxel left without votes is removed.
  void contradictVoxel(const VoxelIndex& voxel);
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
  using Tile = std::vector<Column>;

  Column& touchColumn(int x, int y);
  void addToVoxel(const VoxelIndex& voxel, const VoxelTally& tally);
  void deriveWorst(int x, int y);

  VoteParams vote_;
  int band_min_, band_max_;
  SemanticOcTree tree_;
  std::unordered_map<uint64_t, Tile> tiles_;
  mutable uint64_t last_tile_key_ = 0;
  mutable const Tile* last_tile_ = nullptr;
  std::vector<VoxelIndex> derived_;
  uint32_t frame_ = 0;
  uint64_t version_ = 0;
};

}  // namespace core_perception
