// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/vote_map.h"

#include <cmath>

namespace core_perception {
namespace {

constexpr int kKeyOffset = 32768;  // OctoMap's key of coordinate 0

bool makeKey(const VoxelIndex& voxel, octomap::OcTreeKey* key) {
  const int values[] = {voxel.x + kKeyOffset, voxel.y + kKeyOffset, voxel.z + kKeyOffset};
  for (int i = 0; i < 3; ++i) {
    if (values[i] < 0 || values[i] >= 2 * kKeyOffset) return false;
    (*key)[i] = static_cast<octomap::key_type>(values[i]);
  }
  return true;
}

int floorTo(int value, int step) {
  return value >= 0 ? value / step : -((step - 1 - value) / step);
}

uint64_t makeTileKey(int tile_x, int tile_y) {
  return (static_cast<uint64_t>(static_cast<uint32_t>(tile_x)) << 32) |
         static_cast<uint32_t>(tile_y);
}

}  // namespace

VoteMap::VoteMap(double resolution_m, const RangeParams& range, const VoteParams& vote)
    : vote_(vote),
      band_min_(
          static_cast<int>(std::floor((range.floor_z_m + range.band_min_z_m) / resolution_m))),
      // A voxel whose lower face lies at the top of the band does not reach into it.
      band_max_(static_cast<int>(
                    std::ceil((range.floor_z_m + range.band_max_z_m) / resolution_m - 1e-9)) -
                1),
      tree_(resolution_m) {}

void VoteMap::add(const FrameVotes& votes) {
  ++frame_;
  ++version_;
  derived_.clear();
  for (const uint32_t touched : votes.touched())
    addToVoxel(votes.indexOf(touched), votes.tally(touched));
  for (const VoxelIndex& column : derived_) deriveWorst(column.x, column.y);
}

void VoteMap::addToVoxel(const VoxelIndex& voxel, const VoxelTally& tally) {
  octomap::OcTreeKey key;
  if (!makeKey(voxel, &key)) return;
  const bool metric = vote_.metric_layer && tally.n_metric >= vote_.metric_min_points;
  const uint64_t n_floor = static_cast<uint64_t>(tally.n_safe) + tally.n_unsafe;
  if (!metric && n_floor == 0) return;
  const bool unsafe = metric || 2 * static_cast<uint64_t>(tally.n_unsafe) >= n_floor;

  SemanticOcTreeNode* node = tree_.touch(key);
  Counts counts{node->n_safe(), node->n_unsafe()};
  if (vote_.votes == "pixel") {
    addVotes(tally.n_safe, tally.n_unsafe + tally.n_metric, &counts);
  } else {
    addFrameVote(!unsafe, static_cast<uint32_t>(vote_.count_cap), &counts);
  }
  node->setCounts(counts.n_safe, counts.n_unsafe);

  if (voxel.z < band_min_ || voxel.z > band_max_) return;
  Column& column = touchColumn(voxel.x, voxel.y);
  if (vote_.column == "sum") {
    addVotes(tally.n_safe, tally.n_unsafe + tally.n_metric, &column.counts);
  } else if (column.derived_frame != frame_) {
    column.derived_frame = frame_;
    derived_.push_back(voxel);
  }
  if (unsafe && (metric || column.cause_frame != frame_)) {
    column.cause = metric ? tally.metric_cause : tally.cause;
    column.cause_frame = frame_;
  }
}

Counts VoteMap::counts(const VoxelIndex& voxel) const {
  octomap::OcTreeKey key;
  if (!makeKey(voxel, &key)) return Counts();
  const SemanticOcTreeNode* node = tree_.find(key);
  return node == nullptr ? Counts() : Counts{node->n_safe(), node->n_unsafe()};
}

void VoteMap::deriveWorst(int x, int y) {
  Counts worst;
  for (int z = band_min_; z <= band_max_; ++z) {
    const Counts voxel = counts({x, y, z});
    if (!voxel.empty() && (worst.empty() || isWorse(voxel, worst))) worst = voxel;
  }
  touchColumn(x, y).counts = worst;
}

void VoteMap::contradictVoxel(const VoxelIndex& voxel) {
  octomap::OcTreeKey key;
  Counts left = counts(voxel);
  if (left.n_unsafe == 0 || !makeKey(voxel, &key)) return;
  contradict(&left);
  if (left.empty()) {
    tree_.erase(key);
  } else {
    tree_.touch(key)->setCounts(left.n_safe, left.n_unsafe);
  }
  ++version_;
  deriveWorst(voxel.x, voxel.y);
}

Column& VoteMap::touchColumn(int x, int y) {
  const int tile_x = floorTo(x, kTile), tile_y = floorTo(y, kTile);
  Tile& tile = tiles_[makeTileKey(tile_x, tile_y)];
  if (tile.empty()) {
    tile.resize(kTile * kTile);
    last_tile_ = nullptr;
  }
  return tile[(y - tile_y * kTile) * kTile + (x - tile_x * kTile)];
}

const Column* VoteMap::find(int x, int y) const {
  const int tile_x = floorTo(x, kTile), tile_y = floorTo(y, kTile);
  const uint64_t key = makeTileKey(tile_x, tile_y);
  if (last_tile_ == nullptr || key != last_tile_key_) {
    const auto it = tiles_.find(key);
    if (it == tiles_.end()) return nullptr;
    last_tile_ = &it->second;
    last_tile_key_ = key;
  }
  const Column& column = (*last_tile_)[(y - tile_y * kTile) * kTile + (x - tile_x * kTile)];
  return column.counts.empty() ? nullptr : &column;
}

void VoteMap::clear() {
  tree_.clear();
  tiles_.clear();
  last_tile_ = nullptr;
  frame_ = 0;
  ++version_;
}

}  // namespace core_perception
