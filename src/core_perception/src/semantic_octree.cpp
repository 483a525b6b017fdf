// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/semantic_octree.h"

#include <algorithm>
#include <cmath>
#include <istream>
#include <limits>
#include <ostream>
#include <utility>

namespace core_perception {

namespace {

constexpr size_t kMostChanges = 10000;  // nobody may ever take them

/// Below 1 exactly where the safe votes are more, whatever is rounded.
float computeOdds(uint32_t n_safe, uint32_t n_unsafe) {
  constexpr float kBelowOne = 1.0f - std::numeric_limits<float>::epsilon() / 2.0f;
  const float odds = (static_cast<float>(n_unsafe) + 0.5f) / (static_cast<float>(n_safe) + 0.5f);
  return n_unsafe < n_safe ? std::min(odds, kBelowOne) : odds;
}

}  // namespace

void SemanticOcTreeNode::copyData(const SemanticOcTreeNode& from) {
  octomap::OcTreeNode::copyData(from);
  n_safe_ = from.n_safe_;
  n_unsafe_ = from.n_unsafe_;
}

void SemanticOcTreeNode::setCounts(uint32_t n_safe, uint32_t n_unsafe) {
  n_safe_ = n_safe;
  n_unsafe_ = n_unsafe;
  setValue(std::log(computeOdds(n_safe, n_unsafe)));
}

void SemanticOcTreeNode::freeChildren() {
  delete[] children;
  children = nullptr;
}

std::istream& SemanticOcTreeNode::readData(std::istream& stream) {
  stream.read(reinterpret_cast<char*>(&value), sizeof(value));
  stream.read(reinterpret_cast<char*>(&n_safe_), sizeof(n_safe_));
  return stream.read(reinterpret_cast<char*>(&n_unsafe_), sizeof(n_unsafe_));
}

std::ostream& SemanticOcTreeNode::writeData(std::ostream& stream) const {
  stream.write(reinterpret_cast<const char*>(&value), sizeof(value));
  stream.write(reinterpret_cast<const char*>(&n_safe_), sizeof(n_safe_));
  return stream.write(reinterpret_cast<const char*>(&n_unsafe_), sizeof(n_unsafe_));
}

SemanticOcTree::Registration SemanticOcTree::registration_;

SemanticOcTree::Registration::Registration() {
  auto* prototype = new SemanticOcTree(0.1);  // owned by OctoMap's factory from here on
  prototype->clearKeyRays();
  octomap::AbstractOcTree::registerTreeType(prototype);
}

SemanticOcTree::SemanticOcTree(double resolution_m)
    : octomap::OccupancyOcTreeBase<SemanticOcTreeNode>(resolution_m) {
  registration_.ensureLinking();
}

SemanticOcTreeNode* SemanticOcTree::touch(const octomap::OcTreeKey& key) {
  if (root == nullptr) {
    root = new SemanticOcTreeNode();
    ++tree_size;
    size_changed = true;
    path_valid_ = false;
  }
  unsigned depth = 0;
  if (path_valid_) {
    // The common path ends above the highest bit in which the keys differ.
    unsigned differing =
        (key[0] ^ last_key_[0]) | (key[1] ^ last_key_[1]) | (key[2] ^ last_key_[2]);
    for (depth = kDepth; differing != 0; differing >>= 1) --depth;
  }
  path_[0] = root;
  for (; depth < kDepth; ++depth) {
    SemanticOcTreeNode* node = path_[depth];
    const unsigned child = octomap::computeChildIdx(key, static_cast<int>(kDepth - 1 - depth));
    if (!nodeChildExists(node, child)) {
      // A leaf with votes above the last level stands for all it covers.
      const bool pruned_leaf =
          !nodeHasChildren(node) && (node->n_safe() > 0 || node->n_unsafe() > 0);
      if (pruned_leaf) {
        expandNode(node);
      } else {
        createNodeChild(node, child);
      }
    }
    path_[depth + 1] = getNodeChild(node, child);
  }
  last_key_ = key;
  path_valid_ = true;
  noteChange(key);
  return path_[kDepth];
}

void SemanticOcTree::erase(const octomap::OcTreeKey& key) {
  if (search(key) == nullptr) return;
  touch(key);  // expands a pruned leaf on the way and fills path_
  eraseUpward(key, kDepth);
}

/// Removes the last node of path_, which has this depth, with inner nodes that become empty.
void SemanticOcTree::eraseUpward(const octomap::OcTreeKey& key, unsigned depth) {
  path_valid_ = false;
  ++layout_;
  for (; depth > 0; --depth) {
    SemanticOcTreeNode* parent = path_[depth - 1];
    deleteNodeChild(parent, octomap::computeChildIdx(key, static_cast<int>(kDepth - depth)));
    if (nodeHasChildren(parent)) return;
    parent->freeChildren();
  }
  clear();  // a root without children would stand for the whole world
}

void SemanticOcTree::eraseCube(const octomap::OcTreeKey& key, unsigned depth) {
  path_valid_ = false;
  path_[0] = root;
  for (unsigned d = 0; d < depth; ++d) {
    if (path_[d] == nullptr) return;
    const unsigned child = octomap::computeChildIdx(key, static_cast<int>(kDepth - 1 - d));
    const bool pruned_leaf = path_[d]->n_safe() > 0 || path_[d]->n_unsafe() > 0;
    if (pruned_leaf) expandNode(path_[d]);
    path_[d + 1] = nodeChildExists(path_[d], child) ? getNodeChild(path_[d], child) : nullptr;
  }
  if (path_[depth] == nullptr) return;
  eraseBelow(path_[depth]);
  eraseUpward(key, depth);
  const unsigned edge = 1u << (kDepth - depth), step = 1u << (kDepth - kBlockDepth);
  for (unsigned x = 0; x < edge; x += step) {
    for (unsigned y = 0; y < edge; y += step) {
      for (unsigned z = 0; z < edge; z += step) {
        noteChange(octomap::OcTreeKey(static_cast<octomap::key_type>((key[0] & ~(edge - 1)) + x),
                                      static_cast<octomap::key_type>((key[1] & ~(edge - 1)) + y),
                                      static_cast<octomap::key_type>((key[2] & ~(edge - 1)) + z)));
      }
    }
  }
}

void SemanticOcTree::eraseBelow(SemanticOcTreeNode* node) {
  if (!nodeHasChildren(node)) return;
  for (unsigned i = 0; i < 8; ++i) {
    if (!nodeChildExists(node, i)) continue;
    eraseBelow(getNodeChild(node, i));
    deleteNodeChild(node, i);
  }
  node->freeChildren();
}

void SemanticOcTree::clear() {
  path_valid_ = false;
  ++layout_;
  noteChangeEverywhere();
  octomap::OccupancyOcTreeBase<SemanticOcTreeNode>::clear();
}

void SemanticOcTree::prune() {
  path_valid_ = false;
  ++layout_;
  noteChangeEverywhere();
  octomap::OccupancyOcTreeBase<SemanticOcTreeNode>::prune();
}

void SemanticOcTree::expand() {
  path_valid_ = false;
  ++layout_;
  noteChangeEverywhere();
  octomap::OccupancyOcTreeBase<SemanticOcTreeNode>::expand();
}

SemanticOcTree::Changes SemanticOcTree::takeChanges() {
  Changes changes = std::move(changes_);
  changes_.everywhere = false;
  changes_.blocks.clear();
  last_changed_ = ~uint64_t{0};
  return changes;
}

void SemanticOcTree::noteBlock(uint64_t block) {
  if (changes_.everywhere) return;
  last_changed_ = block;
  changes_.blocks.insert(block);
  if (changes_.blocks.size() > kMostChanges) noteChangeEverywhere();
}

void SemanticOcTree::noteChangeEverywhere() {
  changes_.everywhere = true;
  changes_.blocks.clear();
}

void SemanticOcTree::expandNode(SemanticOcTreeNode* node) {
  octomap::OccupancyOcTreeBase<SemanticOcTreeNode>::expandNode(node);
  node->n_safe_ = 0;
  node->n_unsafe_ = 0;
}

std::istream& SemanticOcTree::readData(std::istream& stream) {
  if (root != nullptr) {  // as OctoMap: the caller clears it
    stream.setstate(std::ios::failbit);
    return stream;
  }
  path_valid_ = false;
  noteChangeEverywhere();
  root = new SemanticOcTreeNode();
  tree_size = 1;
  size_changed = true;
  if (!readSubtree(stream, 0, root)) {
    clear();
    stream.setstate(std::ios::failbit);
  }
  return stream;
}

bool SemanticOcTree::readSubtree(std::istream& stream, unsigned depth, SemanticOcTreeNode* node) {
  uint8_t children = 0;
  node->readData(stream);
  stream.read(reinterpret_cast<char*>(&children), sizeof(children));
  if (!stream || !std::isfinite(node->value)) return false;
  if (children == 0) {
    const float stored = node->value;
    node->setCounts(node->n_safe_, node->n_unsafe_);
    constexpr float kRounding = 1e-4f;  // another machine's logarithm
    return std::abs(stored - node->value) <= kRounding;
  }
  if (depth == kDepth || node->n_safe_ != 0 || node->n_unsafe_ != 0) return false;
  for (unsigned i = 0; i < 8; ++i) {
    if ((children & (1u << i)) == 0) continue;
    if (!readSubtree(stream, depth + 1, createNodeChild(node, i))) return false;
  }
  return true;
}

}  // namespace core_perception
