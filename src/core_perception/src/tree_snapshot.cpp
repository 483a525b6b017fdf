// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/tree_snapshot.h"

#include <algorithm>
#include <cstring>
#include <limits>

namespace core_perception {
namespace {

using Bytes = std::vector<int8_t>;

/// Key of the lowest corner of a child that lies at this depth.
octomap::OcTreeKey childKey(octomap::OcTreeKey key, unsigned child, unsigned child_depth) {
  for (unsigned axis = 0; axis < 3; ++axis) {
    if (((child >> axis) & 1u) == 0) continue;
    key[axis] = static_cast<octomap::key_type>(key[axis] + (1u << (16 - child_depth)));
  }
  return key;
}

/// Appends a node whose children appendChild(i) appends, which returns their value.
/// @returns the value of the node: that of a leaf, or the largest below it.
template <typename AppendChild>
float appendNode(const SemanticOcTree& tree, const SemanticOcTreeNode& node, Bytes* bytes,
                 AppendChild appendChild) {
  const size_t at = bytes->size();
  bytes->resize(at + TreeSnapshot::kNodeSize);
  FlatNode flat;
  flat.value = -std::numeric_limits<float>::max();
  for (unsigned i = 0; i < 8; ++i) {
    if (!tree.nodeChildExists(&node, i)) continue;
    flat.children = static_cast<uint8_t>(flat.children | (1u << i));
    flat.value = std::max(flat.value, appendChild(i));
  }
  if (flat.children == 0) {
    flat.value = node.getValue();
    flat.counts = Counts{node.n_safe(), node.n_unsafe()};
  }
  flat.store(bytes->data() + at);
  return flat.value;
}

float appendSubtree(const SemanticOcTree& tree, const SemanticOcTreeNode& node, Bytes* bytes) {
  return appendNode(tree, node, bytes, [&](unsigned i) {
    return appendSubtree(tree, *tree.getNodeChild(&node, i), bytes);
  });
}

void visitLeaves(const int8_t** in, SnapshotLeaf place,
                 const std::function<void(const SnapshotLeaf&)>& visit) {
  const FlatNode node = FlatNode::load(*in);
  *in += TreeSnapshot::kNodeSize;
  if (node.children == 0) {
    place.counts = node.counts;
    visit(place);
    return;
  }
  for (unsigned i = 0; i < 8; ++i) {
    if ((node.children & (1u << i)) == 0) continue;
    SnapshotLeaf child;
    child.depth = place.depth + 1;
    child.lowest = childKey(place.lowest, i, child.depth);
    visitLeaves(in, child, visit);
  }
}

}  // namespace

FlatNode FlatNode::load(const int8_t* at) {
  FlatNode node;
  std::memcpy(&node.value, at, 4);
  std::memcpy(&node.counts.n_safe, at + 4, 4);
  std::memcpy(&node.counts.n_unsafe, at + 8, 4);
  std::memcpy(&node.children, at + 12, 1);
  return node;
}

void FlatNode::store(int8_t* at) const {
  std::memcpy(at, &value, 4);
  std::memcpy(at + 4, &counts.n_safe, 4);
  std::memcpy(at + 8, &counts.n_unsafe, 4);
  std::memcpy(at + 12, &children, 1);
}

TreeSnapshot takeSnapshot(const SemanticOcTree& tree) {
  TreeSnapshot snapshot;
  snapshot.resolution_m = tree.getResolution();
  if (tree.getRoot() == nullptr) return snapshot;
  snapshot.nodes.reserve(tree.size() * TreeSnapshot::kNodeSize);
  appendSubtree(tree, *tree.getRoot(), &snapshot.nodes);
  return snapshot;
}

TreeSnapshot SnapshotTaker::take(SemanticOcTree* tree) {
  const SemanticOcTree::Changes changes = tree->takeChanges();
  if (changes.everywhere) blocks_.clear();
  for (const uint64_t block : changes.blocks) blocks_.erase(block);
  TreeSnapshot snapshot;
  snapshot.resolution_m = tree->getResolution();
  if (tree->getRoot() == nullptr) return snapshot;
  snapshot.nodes.reserve(tree->size() * TreeSnapshot::kNodeSize);
  append(*tree, *tree->getRoot(), octomap::OcTreeKey(0, 0, 0), 0, &snapshot.nodes);
  return snapshot;
}

float SnapshotTaker::append(const SemanticOcTree& tree, const SemanticOcTreeNode& node,
                            const octomap::OcTreeKey& key, unsigned depth, Bytes* bytes) {
  if (depth < SemanticOcTree::kBlockDepth) {
    return appendNode(tree, node, bytes, [&](unsigned i) {
      return append(tree, *tree.getNodeChild(&node, i), childKey(key, i, depth + 1), depth + 1,
                    bytes);
    });
  }
  Bytes& block = blocks_[SemanticOcTree::blockOf(key)];
  if (block.empty()) appendSubtree(tree, node, &block);
  bytes->insert(bytes->end(), block.begin(), block.end());
  return FlatNode::load(block.data()).value;
}

void forEachLeaf(const TreeSnapshot& snapshot,
                 const std::function<void(const SnapshotLeaf&)>& visit) {
  if (snapshot.nodes.empty()) return;
  SnapshotLeaf root;
  root.depth = 0;
  const int8_t* in = snapshot.nodes.data();
  visitLeaves(&in, root, visit);
}

}  // namespace core_perception
