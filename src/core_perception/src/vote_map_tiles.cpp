// SPDX-License-Identifier: BSD-3-Clause
// Tiles taken out of a VoteMap and put back; see RollingWindow.
#include <set>
#include <utility>

#include "core_perception/vote_map.h"
#include "core_perception/voxel_key.h"

namespace core_perception {
namespace {

constexpr unsigned kTileDepth = 11;  // of the nodes of the tree that are a tile wide

}  // namespace

std::vector<CellIndex> VoteMap::listTiles() const {
  std::set<CellIndex> found;
  for (const auto& tile : tiles_) {
    found.insert({static_cast<int>(static_cast<uint32_t>(tile.first >> 32)),
                  static_cast<int>(static_cast<uint32_t>(tile.first))});
  }
  const auto end = tree_.end_leafs();
  for (auto cube = tree_.begin_leafs(kTileDepth); cube != end; ++cube) {
    const VoxelIndex lowest = indexOf(cube.getIndexKey());
    found.insert({floorTo<kTile>(lowest.x), floorTo<kTile>(lowest.y)});
  }
  return {found.begin(), found.end()};
}

MapTile VoteMap::takeTile(const CellIndex& tile) {
  MapTile content;
  const auto it = tiles_.find(makeTileKey(tile.x, tile.y));
  if (it != tiles_.end()) {
    content.columns = std::move(it->second->columns);
    for (const BandVoxel& voxel : it->second->band) content.band.push_back(voxel.counts);
    tiles_.erase(it);
    forgetNearTiles();
  }
  // Nothing prunes this tree: each leaf is one voxel.
  for (int z = floorTo<kTile>(tree_min_) * kTile; z <= tree_max_; z += kTile) {
    octomap::OcTreeKey lowest;
    if (!makeKey({tile.x * kTile, tile.y * kTile, z}, &lowest)) continue;
    octomap::OcTreeKey highest = lowest;
    for (unsigned axis = 0; axis < 3; ++axis)
      highest[axis] = static_cast<octomap::key_type>(highest[axis] + kTile - 1);
    const auto end = tree_.end_leafs_bbx();
    for (auto leaf = tree_.begin_leafs_bbx(lowest, highest); leaf != end; ++leaf)
      content.voxels.push_back({indexOf(leaf.getKey()), {leaf->n_safe(), leaf->n_unsafe()}});
    tree_.eraseCube(lowest, kTileDepth);
  }
  ++version_;
  return content;
}

void VoteMap::putTile(const CellIndex& tile, MapTile content) {
  for (const MapTile::Voxel& voxel : content.voxels) {
    octomap::OcTreeKey key;
    if (!makeKey(voxel.index, &key)) continue;
    tree_.touch(key)->setCounts(voxel.counts.n_safe, voxel.counts.n_unsafe);
  }
  if (!content.columns.empty()) {
    auto whole = std::make_unique<Tile>();
    whole->columns = std::move(content.columns);
    for (const Counts& counts : content.band) whole->band.push_back({counts, nullptr});
    tiles_[makeTileKey(tile.x, tile.y)] = std::move(whole);
    forgetNearTiles();
  }
  ++version_;
}

}  // namespace core_perception
