// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/vote_map.h"

#include <cmath>
#include <utility>

namespace core_perception {
namespace {

constexpr int kKeyOffset = SemanticOcTree::kKeyOffset;

bool makeKey(const VoxelIndex& voxel, octomap::OcTreeKey* key) {
  const int values[] = {voxel.x + kKeyOffset, voxel.y + kKeyOffset, voxel.z + kKeyOffset};
  for (int i = 0; i < 3; ++i) {
    if (values[i] < 0 || values[i] >= 2 * kKeyOffset) return false;
    (*key)[i] = static_cast<octomap::key_type>(values[i]);
  }
  return true;
}

VoxelIndex indexOf(const octomap::OcTreeKey& key) {
  return {key[0] - kKeyOffset, key[1] - kKeyOffset, key[2] - kKeyOffset};
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
      by_pixel_(vote.votes == "pixel"),
      by_sum_(vote.column == "sum"),
      tree_min_(
          static_cast<int>(std::floor((range.floor_z_m + range.tree_min_z_m) / resolution_m))),
      tree_max_(
          static_cast<int>(std::floor((range.floor_z_m + range.tree_max_z_m) / resolution_m))),
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
  for (const Place& place : derived_) derive(place);
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
  if (by_pixel_) {
    addVotes(tally.n_safe, tally.n_unsafe + tally.n_metric, &counts);
  } else {
    addFrameVote(!unsafe, static_cast<uint32_t>(vote_.count_cap), &counts);
  }
  node->setCounts(counts.n_safe, counts.n_unsafe);
  if (!isInBand(voxel.z)) return;
  const Place place = touchPlace(voxel.x, voxel.y);
  place.band[voxel.z - band_min_] = counts;
  addToColumn(tally, metric, unsafe, place);
}

void VoteMap::addToColumn(const VoxelTally& tally, bool metric, bool unsafe, const Place& place) {
  Column& column = *place.column;
  if (column.derived_frame != frame_) {
    column.derived_frame = frame_;
    derived_.push_back(place);
  }
  if (unsafe && (metric || column.cause_frame != frame_)) {
    column.cause = metric ? tally.metric_cause : tally.cause;
    column.cause_frame = frame_;
  }
}

Counts VoteMap::counts(const VoxelIndex& voxel) const {
  if (isInBand(voxel.z)) {
    const Place place = findPlace(voxel.x, voxel.y);
    return place.band == nullptr ? Counts() : place.band[voxel.z - band_min_];
  }
  octomap::OcTreeKey key;
  if (!makeKey(voxel, &key)) return Counts();
  const SemanticOcTreeNode* node = tree_.find(key);
  return node == nullptr ? Counts() : Counts{node->n_safe(), node->n_unsafe()};
}

void VoteMap::derive(const Place& place) const {
  Counts counts;
  for (int i = 0; i <= band_max_ - band_min_; ++i) joinColumn(place.band[i], by_sum_, &counts);
  place.column->counts = counts;
}

/// Writes the votes of a voxel into the tree and beside its column, which is to be derived then.
void VoteMap::setVoxel(const VoxelIndex& voxel, const Counts& counts) {
  octomap::OcTreeKey key;
  if (!makeKey(voxel, &key)) return;
  if (counts.empty()) {
    tree_.erase(key);
  } else {
    tree_.touch(key)->setCounts(counts.n_safe, counts.n_unsafe);
  }
  if (isInBand(voxel.z)) touchPlace(voxel.x, voxel.y).band[voxel.z - band_min_] = counts;
}

void VoteMap::contradictVoxel(const VoxelIndex& voxel) {
  Counts left = counts(voxel);
  if (left.n_unsafe == 0 || !isInBand(voxel.z)) return;
  contradict(&left);
  ++version_;
  setVoxel(voxel, left);
  derive(touchPlace(voxel.x, voxel.y));
}

int VoteMap::clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m) {
  std::vector<VoxelIndex> inside;
  const auto end = tree_.end_leafs();
  for (auto leaf = tree_.begin_leafs(); leaf != end; ++leaf) {
    const Eigen::Vector3d centre(leaf.getX(), leaf.getY(), leaf.getZ());
    const bool is_inside =
        (centre.array() >= min_m.array()).all() && (centre.array() <= max_m.array()).all();
    if (is_inside) inside.push_back(indexOf(leaf.getKey()));
  }
  for (const VoxelIndex& voxel : inside) setVoxel(voxel, Counts());
  for (const VoxelIndex& voxel : inside) {
    if (isInBand(voxel.z)) derive(touchPlace(voxel.x, voxel.y));
  }
  if (!inside.empty()) ++version_;
  return static_cast<int>(inside.size());
}

void VoteMap::load(const SemanticOcTree& saved, bool with_safe, uint16_t cause) {
  ++version_;
  const auto end = saved.end_leafs();
  for (auto leaf = saved.begin_leafs(); leaf != end; ++leaf) {
    Counts counts{leaf->n_safe(), leaf->n_unsafe()};
    if (counts.empty() || (!with_safe && isSafe(counts, vote_.tau))) continue;
    if (!with_safe) counts.n_safe = 0;
    if (!by_pixel_) limitVotes(static_cast<uint32_t>(vote_.count_cap), &counts);
    // A pruned leaf stands for all voxels that it covers.
    const int n = 1 << (tree_.getTreeDepth() - leaf.getDepth());
    const VoxelIndex first = indexOf(leaf.getIndexKey());
    for (int i = 0; i < n * n * n; ++i) {
      const VoxelIndex voxel{first.x + i % n, first.y + i / n % n, first.z + i / n / n};
      if (voxel.z < tree_min_ || voxel.z > tree_max_) continue;
      setVoxel(voxel, counts);
      if (!isInBand(voxel.z)) continue;
      const Place place = touchPlace(voxel.x, voxel.y);
      derive(place);
      place.column->cause = cause;
    }
  }
}

VoteMap::Place VoteMap::findPlace(int x, int y) const {
  const int tile_x = floorTo(x, kTile), tile_y = floorTo(y, kTile);
  const uint64_t key = makeTileKey(tile_x, tile_y);
  if (last_tile_ == nullptr || key != last_tile_key_) {
    const auto it = tiles_.find(key);
    if (it == tiles_.end()) return Place();
    last_tile_ = it->second.get();
    last_tile_key_ = key;
  }
  const size_t i = static_cast<size_t>(y - tile_y * kTile) * kTile + (x - tile_x * kTile);
  const auto layers = static_cast<size_t>(band_max_ - band_min_ + 1);
  return {&last_tile_->columns[i], &last_tile_->band[i * layers]};
}

VoteMap::Place VoteMap::touchPlace(int x, int y) {
  const Place known = findPlace(x, y);
  if (known.column != nullptr) return known;
  auto tile = std::make_unique<Tile>();
  tile->columns.resize(kTile * kTile);
  tile->band.resize(static_cast<size_t>(kTile * kTile) * (band_max_ - band_min_ + 1));
  tiles_[makeTileKey(floorTo(x, kTile), floorTo(y, kTile))] = std::move(tile);
  return findPlace(x, y);
}

const Column* VoteMap::find(int x, int y) const {
  const Place place = findPlace(x, y);
  return place.column == nullptr || place.column->counts.empty() ? nullptr : place.column;
}

void VoteMap::clear() {
  tree_.clear();
  tiles_.clear();
  last_tile_ = nullptr;
  frame_ = 0;
  ++version_;
}

}  // namespace core_perception
