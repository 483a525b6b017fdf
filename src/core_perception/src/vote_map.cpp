// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/vote_map.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "core_perception/voxel_key.h"

namespace core_perception {
constexpr int VoteMap::kTile;

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

void VoteMap::add(const FrameVotes& votes, const CauseTable& causes) {
  ++frame_;
  ++version_;
  derived_.clear();
  forgetMovedLeaves();
  const Tallies tallies = votes.tallies();
  for (uint32_t i = 0; i < tallies.size(); ++i) {
    const VoxelTally& tally = tallies[i];
    addToVoxel(votes.indexOf(tally.voxel), tally, i, causes);
  }
  spreadMovers(votes, causes);
  for (const Place& place : derived_) derive(place);
}

void VoteMap::forgetMovedLeaves() {
  if (tree_.layout() == layout_) return;
  layout_ = tree_.layout();
  for (auto& tile : tiles_) {
    for (BandVoxel& voxel : tile.second->band) voxel.leaf = nullptr;
  }
}

/// @param number of the tally in the frame.
void VoteMap::addToVoxel(const VoxelIndex& voxel, const VoxelTally& tally, uint32_t number,
                         const CauseTable& causes) {
  octomap::OcTreeKey key;
  if (!makeKey(voxel, &key)) return;
  const bool metric = isMetric(tally);
  const uint64_t n_floor = static_cast<uint64_t>(tally.n_safe()) + tally.n_unsafe();
  if (!metric && n_floor == 0) return;
  const bool unsafe = metric || 2 * static_cast<uint64_t>(tally.n_unsafe()) >= n_floor;

  if (unsafe) noteMover(voxel, tally.cause[metric ? kMetricVote : kUnsafeVote], causes);
  if (!isInBand(voxel.z)) {
    SemanticOcTreeNode* leaf = tree_.touch(key);
    Counts counts{leaf->n_safe(), leaf->n_unsafe()};
    addVotesOf(tally, unsafe, &counts);
    leaf->setCounts(counts.n_safe, counts.n_unsafe);
    return;
  }
  const Place place = touchPlace(voxel.x, voxel.y);
  BandVoxel& seen = touchBand(voxel, place);
  if (seen.leaf == nullptr) seen.leaf = tree_.touch(key);
  addVotesOf(tally, unsafe, &seen.counts);
  tree_.setCounts(key, seen.counts.n_safe, seen.counts.n_unsafe, seen.leaf);
  place.column->seen = true;
  if (place.column->derived_frame != frame_) {
    place.column->derived_frame = frame_;
    derived_.push_back(place);
  }
  // A metric cause comes before others; of these the newest counts, of the others the first.
  constexpr uint32_t kMetric = 1u << 31;
  if (metric) noteCause(tally.cause[kMetricVote], kMetric + number, place.column);
  if (unsafe && !metric) noteCause(tally.cause[kUnsafeVote], kMetric - 1 - number, place.column);
}

bool VoteMap::isMetric(const VoxelTally& tally) const {
  return vote_.metric_layer && tally.n_metric() >= static_cast<uint32_t>(vote_.metric_min_points);
}

void VoteMap::addVotesOf(const VoxelTally& tally, bool unsafe, Counts* counts) const {
  if (by_pixel_) {
    addVotes(tally.n_safe(), tally.n_unsafe() + tally.n_metric(), counts);
  } else {
    addFrameVote(!unsafe, static_cast<uint32_t>(vote_.count_cap), counts);
  }
}

void VoteMap::noteCause(uint16_t cause, uint32_t rank, Column* column) const {
  if (column->cause_frame == frame_ && rank < column->cause_rank) return;
  column->cause = cause;
  column->cause_frame = frame_;
  column->cause_rank = rank;
}

Counts VoteMap::counts(const VoxelIndex& voxel) const {
  if (isInBand(voxel.z)) {
    const Place place = findPlace(voxel.x, voxel.y);
    return place.column == nullptr ? Counts() : place.voxel(voxel.z - band_min_).counts;
  }
  octomap::OcTreeKey key;
  if (!makeKey(voxel, &key)) return Counts();
  const SemanticOcTreeNode* node = tree_.find(key);
  return node == nullptr ? Counts() : Counts{node->n_safe(), node->n_unsafe()};
}

void VoteMap::derive(const Place& place) const {
  Counts counts;
  for (int i = place.column->first_layer; i < place.column->end_layer; ++i)
    joinColumn(place.voxel(i).counts, by_sum_, &counts);
  place.column->counts = counts;
}

/// Writes the votes of a voxel into the tree and beside its column, which is to be derived then.
void VoteMap::setVoxel(const VoxelIndex& voxel, const Counts& counts) {
  octomap::OcTreeKey key;
  if (!makeKey(voxel, &key)) return;
  SemanticOcTreeNode* leaf = nullptr;
  if (counts.empty()) {
    forgetMovedLeaves();
    tree_.erase(key);
    layout_ = tree_.layout();  // no other leaf has moved
  } else {
    leaf = tree_.touch(key);
    leaf->setCounts(counts.n_safe, counts.n_unsafe);
  }
  if (isInBand(voxel.z)) touchBand(voxel, touchPlace(voxel.x, voxel.y)) = {counts, leaf};
}

VoteMap::BandVoxel& VoteMap::touchBand(const VoxelIndex& voxel, const Place& place) {
  const auto layer = static_cast<uint16_t>(voxel.z - band_min_);
  place.column->first_layer = std::min(place.column->first_layer, layer);
  place.column->end_layer = std::max<uint16_t>(place.column->end_layer, layer + 1);
  return place.voxel(layer);
}

void VoteMap::contradictVoxel(const VoxelIndex& voxel) {
  Counts left = counts(voxel);
  if (left.n_unsafe == 0 || !isInBand(voxel.z)) return;
  contradict(&left);
  if (left.n_unsafe == 0) mobile_.remove(voxel);
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
  mobile_.clear();
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
      place.column->seen = true;
    }
  }
}

VoteMap::Place VoteMap::findPlace(int x, int y) const {
  const int tile_x = floorTo<kTile>(x), tile_y = floorTo<kTile>(y);
  const uint64_t key = makeTileKey(tile_x, tile_y);
  NearTile& near =
      near_[static_cast<unsigned>(tile_x) % kNear * kNear + static_cast<unsigned>(tile_y) % kNear];
  if (near.tile == nullptr || near.key != key) {
    const auto it = tiles_.find(key);
    if (it == tiles_.end()) return Place();
    near = {key, it->second.get()};
  }
  const size_t i = static_cast<size_t>(y - tile_y * kTile) * kTile + (x - tile_x * kTile);
  return {&near.tile->columns[i], &near.tile->band[i]};
}

VoteMap::Place VoteMap::touchPlace(int x, int y) {
  const Place known = findPlace(x, y);
  if (known.column != nullptr) return known;
  auto tile = std::make_unique<Tile>();
  tile->columns.resize(kTile * kTile);
  tile->band.resize(static_cast<size_t>(kTile * kTile) * (band_max_ - band_min_ + 1));
  tiles_[makeTileKey(floorTo<kTile>(x), floorTo<kTile>(y))] = std::move(tile);
  return findPlace(x, y);
}

const Column* VoteMap::find(int x, int y) const {
  const Place place = findPlace(x, y);
  return place.column == nullptr || place.column->counts.empty() ? nullptr : place.column;
}

void VoteMap::forgetNearTiles() const { std::fill(std::begin(near_), std::end(near_), NearTile()); }

const Column* VoteMap::findRow(int x, int y, int* n_columns) const {
  *n_columns = std::min(*n_columns, (floorTo<kTile>(x) + 1) * kTile - x);
  return findPlace(x, y).column;
}

void VoteMap::clear() {
  mobile_.clear();
  tree_.clear();
  tiles_.clear();
  forgetNearTiles();
  frame_ = 0;
  ++version_;
}

}  // namespace core_perception
