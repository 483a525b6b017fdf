// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <unordered_map>
#include <vector>

#include "core_perception/semantic_octree.h"
#include "core_perception/vote_rule.h"

namespace core_perception {

/// A whole tree at one instant, in one block of memory. Taking it is the only part of publishing or
/// saving that must not happen while the map changes; all else works on the copy.
struct TreeSnapshot {
  double resolution_m = 0.0;
  /// Nodes in OctoMap's pre-order, empty for an empty tree: the payload of a SemanticOcTree
  /// message, float32 value, uint32 n_safe, uint32 n_unsafe, then one bit for each child that
  /// follows. Inner nodes have the largest value below them, as after updateInnerOccupancy().
  std::vector<int8_t> nodes;

  static constexpr size_t kNodeSize = 13;
};

/// One node of a snapshot.
struct FlatNode {
  float value = 0.0f;
  Counts counts;
  uint8_t children = 0;

  static FlatNode load(const int8_t* at);
  void store(int8_t* at) const;
};

TreeSnapshot takeSnapshot(const SemanticOcTree& tree);

/// Takes snapshots of one tree again and again. Walking a large tree waits for memory at every
/// node (0.1 us each), so the bytes of each block are kept, and only blocks that changed are walked
/// again: the time depends on what was seen since, not on the size of the map.
class SnapshotTaker {
 public:
  TreeSnapshot take(SemanticOcTree* tree);

 private:
  float append(const SemanticOcTree& tree, const SemanticOcTreeNode& node,
               const octomap::OcTreeKey& key, unsigned depth, std::vector<int8_t>* bytes);

  std::unordered_map<uint64_t, std::vector<int8_t>> blocks_;
};

/// A voxel, or a pruned cube of 2^(16 - depth) of them to an edge, all with these votes.
struct SnapshotLeaf {
  octomap::OcTreeKey lowest{0, 0, 0};  ///< key of its corner with the lowest coordinates
  unsigned depth = 16;
  Counts counts;

  int edge() const { return 1 << (16 - depth); }
  bool isUnsafe() const { return counts.n_unsafe >= counts.n_safe; }
};

void forEachLeaf(const TreeSnapshot& snapshot,
                 const std::function<void(const SnapshotLeaf&)>& visit);

}  // namespace core_perception
