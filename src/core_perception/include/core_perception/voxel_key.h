// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>

#include "core_perception/frame_votes.h"
#include "core_perception/semantic_octree.h"

namespace core_perception {

/// OctoMap's key of a voxel.
/// @returns false beyond the 2^15 voxels that keys count to each side of the origin.
inline bool makeKey(const VoxelIndex& voxel, octomap::OcTreeKey* key) {
  constexpr int kOffset = SemanticOcTree::kKeyOffset;
  const int values[] = {voxel.x + kOffset, voxel.y + kOffset, voxel.z + kOffset};
  for (int i = 0; i < 3; ++i) {
    if (values[i] < 0 || values[i] >= 2 * kOffset) return false;
    (*key)[i] = static_cast<octomap::key_type>(values[i]);
  }
  return true;
}

inline VoxelIndex indexOf(const octomap::OcTreeKey& key) {
  constexpr int kOffset = SemanticOcTree::kKeyOffset;
  return {key[0] - kOffset, key[1] - kOffset, key[2] - kOffset};
}

/// floor(value / step).
template <int step>
int floorTo(int value) {
  static_assert((step & (step - 1)) == 0, "a power of two: no division is left of it");
  return (value - (value & (step - 1))) / step;
}

/// One number for the two indices of a tile of the vote map.
inline uint64_t makeTileKey(int tile_x, int tile_y) {
  return (static_cast<uint64_t>(static_cast<uint32_t>(tile_x)) << 32) |
         static_cast<uint32_t>(tile_y);
}

}  // namespace core_perception
