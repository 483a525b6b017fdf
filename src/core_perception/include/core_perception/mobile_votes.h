// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <unordered_map>

#include "core_perception/frame_votes.h"

namespace core_perception {

/// Whose an unsafe vote is.
enum class Mover {
  kAtRest,   ///< the label says a class at rest
  kMoves,    ///< the label says a class that moves
  kUnknown,  ///< no label
};

/// The voxels whose newest unsafe votes were left by things that move, with the time since which
/// there was none. Stamps may repeat, go back or pause: time runs only forward.
///
/// Labels flicker, and their edges are not those of the depth. So a vote without a label leaves a
/// voxel what it was, and what is unsafe without a label within two voxels of one that a label
/// called moving counts as part of it. A voxel leaves when it has no unsafe vote any more, so that
/// no more are held than were voted within a few half-lives.
class MobileVotes {
 public:
  using Visit = std::function<void(const VoxelIndex&)>;
  /// Takes half of the unsafe votes of a voxel so many times; returns whether any are left.
  using Halve = std::function<bool(const VoxelIndex&, int)>;

  /// Notes an unsafe vote.
  void note(const VoxelIndex& voxel, Mover mover);
  /// Adds what is unsafe without a label around those voted just now that a label called moving.
  void spread(const std::function<bool(const VoxelIndex&)>& is_unlabelled);
  /// Calls halve for each voxel as often as half-lives went by since its newest unsafe vote.
  /// @param half_life_s > 0.
  void age(double stamp_s, double half_life_s, const Halve& halve);
  bool has(const VoxelIndex& voxel) const { return voxels_.count(pack(voxel)) > 0; }
  void remove(const VoxelIndex& voxel) { voxels_.erase(pack(voxel)); }
  bool empty() const { return voxels_.empty(); }
  size_t size() const { return voxels_.size(); }
  void clear() { voxels_.clear(); }

 private:
  struct Age {
    bool labelled = false;  ///< a label called it moving
    bool fresh = true;      ///< voted since the last call of age()
    double since_s = 0.0;   ///< newest vote, or newest halving
  };
  static uint64_t pack(const VoxelIndex& voxel);
  static VoxelIndex unpack(uint64_t key);

  std::unordered_map<uint64_t, Age> voxels_;
};

}  // namespace core_perception
