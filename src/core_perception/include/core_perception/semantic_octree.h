// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <octomap/OcTreeNode.h>
#include <octomap/OccupancyOcTreeBase.h>

#include <cstdint>
#include <iosfwd>
#include <string>
#include <unordered_set>

namespace core_perception {

/// A voxel with its votes. The base value follows from them, so that "occupied" means "unsafe":
///
///     value = log((n_unsafe + 1/2) / (n_safe + 1/2))
///
/// Never use the hit / miss updates of OctoMap on it. On the wire: float32 value, uint32 n_safe,
/// uint32 n_unsafe (12 bytes, native byte order, as OctoMap's own nodes). In a pruned leaf the
/// counts hold for every voxel it covers. Inner nodes carry no counts of their own.
class SemanticOcTreeNode : public octomap::OcTreeNode {
 public:
  SemanticOcTreeNode() = default;
  /// Copies the payload, not the children: octomap's own copy would slice them.
  SemanticOcTreeNode(const SemanticOcTreeNode& other) : octomap::OcTreeNode() { copyData(other); }
  SemanticOcTreeNode& operator=(const SemanticOcTreeNode&) = delete;

  /// Equality with counts, so that prune and expand lose nothing.
  bool operator==(const SemanticOcTreeNode& other) const {
    return value == other.value && n_safe_ == other.n_safe_ && n_unsafe_ == other.n_unsafe_;
  }
  void copyData(const SemanticOcTreeNode& from);

  uint32_t n_safe() const { return n_safe_; }
  uint32_t n_unsafe() const { return n_unsafe_; }
  void setCounts(uint32_t n_safe, uint32_t n_unsafe);

  std::istream& readData(std::istream& stream);
  std::ostream& writeData(std::ostream& stream) const;

 private:
  friend class SemanticOcTree;
  /// Frees the array of children; every child must be gone. OctoMap's own deleteNode leaks it.
  void freeChildren();

  uint32_t n_safe_ = 0;
  uint32_t n_unsafe_ = 0;
};

/// OctoMap tree of votes, registered with OctoMap's factory as "SemanticOcTree" in every process
/// that links this library, so that AbstractOcTree::read and createTree + readData (what
/// octomap_msgs does with a message) give it back. A client under a linker that drops unused
/// libraries must name one symbol, such as by dynamic_cast<SemanticOcTree*>.
class SemanticOcTree : public octomap::OccupancyOcTreeBase<SemanticOcTreeNode> {
 public:
  static constexpr int kKeyOffset = 32768;  ///< OctoMap's key of coordinate 0

  explicit SemanticOcTree(double resolution_m);
  SemanticOcTree(const SemanticOcTree&) = delete;
  SemanticOcTree& operator=(const SemanticOcTree&) = delete;

  SemanticOcTree* create() const override { return new SemanticOcTree(resolution); }
  std::string getTreeType() const override { return "SemanticOcTree"; }

  /// The leaf at a key, made where it does not exist; a pruned leaf on the way is expanded first.
  /// Consecutive keys that lie close to each other cost few steps: the last path is kept.
  SemanticOcTreeNode* touch(const octomap::OcTreeKey& key);
  /// Sets the counts of a leaf that touch(key) gave, without a way through the tree.
  void setCounts(const octomap::OcTreeKey& key, uint32_t n_safe, uint32_t n_unsafe,
                 SemanticOcTreeNode* leaf) {
    leaf->setCounts(n_safe, n_unsafe);
    noteChange(key);
  }
  /// As long as this number stays, every leaf that touch() gave is still there. What removes nodes
  /// changes it, except through OctoMap's own methods of the base class.
  uint64_t layout() const { return layout_; }
  /// The leaf at a key or nullptr; a pruned leaf that covers it counts.
  const SemanticOcTreeNode* find(const octomap::OcTreeKey& key) const { return search(key); }
  /// Removes the voxel, with inner nodes that become empty.
  void erase(const octomap::OcTreeKey& key);
  /// Removes every voxel of the cube that a node of this depth (1..12) holds around a key.
  void eraseCube(const octomap::OcTreeKey& key, unsigned depth);
  /// As the base's; drops the kept path.
  void clear() override;
  void prune() override;
  void expand() override;
  /// As the base's, but the node itself keeps no counts: inner nodes have none.
  void expandNode(SemanticOcTreeNode* node) override;

  /// Reads the nodes of a file or a message into an empty tree. OctoMap's own reader recurses as
  /// deep as the bytes say and uses what it could not read; this one checks each node. Bytes that
  /// end early, lie deeper than 16 levels, hold a value that is no number, counts in an inner node,
  /// or a leaf value other than its counts give (by more than rounding) leave the tree empty and
  /// set failbit. Bytes that follow the root's subtree are left in the stream.
  std::istream& readData(std::istream& stream) override;

  /// Subtrees in which voxels were touched or erased.
  struct Changes {
    bool everywhere = true;
    std::unordered_set<uint64_t> blocks;  ///< by blockOf()
  };
  /// Edge of a block: 16 voxels.
  static constexpr unsigned kBlockDepth = 12;
  static uint64_t blockOf(const octomap::OcTreeKey& key) {
    constexpr unsigned kShift = kDepth - kBlockDepth;
    return (static_cast<uint64_t>(key[0] >> kShift) << 32) |
           (static_cast<uint64_t>(key[1] >> kShift) << 16) | (key[2] >> kShift);
  }
  /// What changed since the last call. Changes made through OctoMap's own methods of the base class
  /// (updateNode, deleteNode, ...) are not noticed.
  Changes takeChanges();

 private:
  static constexpr unsigned kDepth = 16;

  void noteChange(const octomap::OcTreeKey& key) {
    const uint64_t block = blockOf(key);
    if (block != last_changed_) noteBlock(block);
  }
  void noteBlock(uint64_t block);
  void noteChangeEverywhere();

  void eraseBelow(SemanticOcTreeNode* node);
  void eraseUpward(const octomap::OcTreeKey& key, unsigned depth);
  bool readSubtree(std::istream& stream, unsigned depth, SemanticOcTreeNode* node);

  struct Registration {
    Registration();
    void ensureLinking() {}
  };
  static Registration registration_;

  SemanticOcTreeNode* path_[kDepth + 1] =
      {};  ///< path_[d]: node of depth d on the way to last_key_
  octomap::OcTreeKey last_key_;
  bool path_valid_ = false;
  uint64_t layout_ = 0;
  Changes changes_;
  uint64_t last_changed_ = ~uint64_t{0};  ///< block noted last
};

}  // namespace core_perception
