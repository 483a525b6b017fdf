// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <unordered_map>
#include <vector>

#include "core_perception/causes.h"
#include "core_perception/frame_votes.h"
#include "core_perception/instance_detector.h"
#include "core_perception/mobile_votes.h"
#include "core_perception/params.h"
#include "core_perception/semantic_octree.h"
#include "core_perception/vote_rule.h"

namespace core_perception {

/// A column of the 2-D map.
struct Column {
  Counts counts;
  uint16_t cause = kNoCause;  ///< of the newest unsafe vote
  bool seen = false;          ///< had votes at some time
  /// Voxels of the band outside [first_layer, end_layer) were never touched; counted from its
  /// lowest.
  uint16_t first_layer = std::numeric_limits<uint16_t>::max(), end_layer = 0;
  uint32_t cause_frame = 0;
  uint32_t cause_rank =
      0;  ///< of the votes of one frame that with the highest rank gives the cause
  uint32_t derived_frame = 0;  ///< of the newest vote
};

/// A square of columns with everything known of them.
struct MapTile {
  struct Voxel {
    VoxelIndex index;
    Counts counts;
  };
  std::vector<Column> columns;  ///< row-major, x fastest; empty where the height band holds nothing
  std::vector<Counts> band;     ///< voxels of the height band, lowest layer first
  std::vector<Voxel> voxels;    ///< every voxel, those of the band too
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
  /// @param causes tells which of them are of things that move.
  void add(const FrameVotes& votes, const CauseTable& causes = CauseTable());
  /// Forgets with time what moving things left: every half-life without another unsafe vote takes
  /// half of a voxel's votes, see fadeVotes(). Where nothing is left the column is unknown again:
  /// floor that was seen before the thing stood there does not come back by itself; what was seen
  /// in the column later holds, and so does what stands there at rest.
  void fade(double stamp_s);
  /// Whether the newest unsafe votes of a voxel were left by what moves.
  bool isMobile(const VoxelIndex& voxel) const;
  /// Takes one unsafe vote from a voxel of the band; a voxel left without votes is removed.
  void contradictVoxel(const VoxelIndex& voxel);
  /// Removes the voxels whose centre lies in the closed box; returns how many.
  int clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m);
  /// Takes the votes of another tree of the same resolution, within the span of this map. Counts
  /// are brought under the cap in proportion. Nothing held then fades any more.
  /// @param with_safe false: only voxels that are not safe, with their unsafe votes alone.
  /// @param cause of what is unsafe by it.
  void load(const SemanticOcTree& saved, bool with_safe, uint16_t cause);
  /// Edge of a tile [columns]. Tile (i, j) holds the columns from (i, j) * kTile on.
  static constexpr int kTile = 32;
  /// Tiles that hold anything.
  std::vector<CellIndex> listTiles() const;
  /// Takes a tile out: nothing is known there then.
  MapTile takeTile(const CellIndex& tile);
  /// Puts back what takeTile gave; nothing may have been added there meanwhile.
  void putTile(const CellIndex& tile, MapTile content);
  /// Voxels of the height band of one column.
  int bandLayers() const { return band_max_ - band_min_ + 1; }
  /// Column or nullptr when nothing was ever seen there.
  const Column* find(int x, int y) const;
  /// The columns at (x, y), (x + 1, y), ... that lie one after the other in memory, nullptr where
  /// none of them was ever seen; others may have no votes either.
  /// @param n_columns how many are wanted; becomes how many are told, at least one.
  const Column* findRow(int x, int y, int* n_columns) const;
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
  static constexpr int kNear = 4;
  /// A voxel of the band: its votes, and its leaf in the tree, nullptr while that is not known.
  struct BandVoxel {
    Counts counts;
    SemanticOcTreeNode* leaf = nullptr;
  };
  /// kTile x kTile columns, and the voxels of the band, one layer after the other: those of the
  /// floor lie together.
  struct Tile {
    std::vector<Column> columns;
    std::vector<BandVoxel> band;
  };
  /// A column of a tile; null pointers where there is no tile.
  struct Place {
    Column* column = nullptr;
    BandVoxel* lowest = nullptr;  ///< of the voxels of the band

    BandVoxel& voxel(int layer) const { return lowest[layer * kTile * kTile]; }
  };

  bool isInBand(int z) const { return z >= band_min_ && z <= band_max_; }
  Place findPlace(int x, int y) const;
  Place touchPlace(int x, int y);
  void forgetNearTiles() const;
  /// Place of a voxel of the band, noted in its column as touched.
  BandVoxel& touchBand(const VoxelIndex& voxel, const Place& place);
  void forgetMovedLeaves();
  void addToVoxel(const VoxelIndex& voxel, const VoxelTally& tally, uint32_t number,
                  const CauseTable& causes);
  bool isMetric(const VoxelTally& tally) const;
  void addVotesOf(const VoxelTally& tally, bool unsafe, Counts* counts) const;
  void noteCause(uint16_t cause, uint32_t rank, Column* column) const;
  void setVoxel(const VoxelIndex& voxel, const Counts& counts);
  void derive(const Place& place) const;
  void noteMover(const VoxelIndex& voxel, uint16_t cause, const CauseTable& causes);
  void spreadMovers(const FrameVotes& votes, const CauseTable& causes);
  bool fadeVoxel(const VoxelIndex& voxel, int half_lives);
  void dropStaleFloor(const VoxelIndex& gone);

  VoteParams vote_;
  bool by_pixel_, by_sum_;
  int tree_min_, tree_max_, band_min_, band_max_;
  SemanticOcTree tree_;
  uint64_t layout_ = 0;  ///< of the tree, when the leaves of the band's voxels were right
  std::unordered_map<uint64_t, std::unique_ptr<Tile>> tiles_;
  /// Tiles that were found last, by the last digits of their indices: those around a camera do not
  /// drive each other out.
  struct NearTile {
    uint64_t key = 0;
    Tile* tile = nullptr;
  };
  mutable NearTile near_[kNear * kNear];
  std::vector<Place> derived_;  ///< columns to derive at the end of a frame
  MobileVotes mobile_;
  uint32_t frame_ = 0;
  uint64_t version_ = 0;
};

}  // namespace core_perception
