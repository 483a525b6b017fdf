// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

namespace core_perception {

/// Votes of a voxel or a cell.
struct Counts {
  uint32_t n_safe = 0;
  uint32_t n_unsafe = 0;

  uint64_t total() const { return static_cast<uint64_t>(n_safe) + n_unsafe; }
  bool empty() const { return total() == 0; }
};

inline bool operator==(const Counts& a, const Counts& b) {
  return a.n_safe == b.n_safe && a.n_unsafe == b.n_unsafe;
}

/// P(safe) >= tau for P = n_safe / (n_safe + n_unsafe); the counts must not both be 0.
/// Source: [CORE] barrier function construction.
bool isSafe(const Counts& counts, double tau);

/// Whether P(safe) of a is smaller than that of b, exactly (integer cross product); of equal ones
/// that with more votes. Both must have votes.
inline bool isWorse(const Counts& a, const Counts& b) {
  // a_s / a_total < b_s / b_total  <=>  a_s b_u < b_s a_u
  const uint64_t left = static_cast<uint64_t>(a.n_safe) * b.n_unsafe;
  const uint64_t right = static_cast<uint64_t>(b.n_safe) * a.n_unsafe;
  return left < right || (left == right && a.total() > b.total());
}

/// Adds raw votes, as [CORE]: never forgotten. Stops at 2^32 - 1 instead of wrapping.
inline void addVotes(uint32_t n_safe, uint32_t n_unsafe, Counts* counts) {
  const auto add = [](uint32_t a, uint32_t b) {
    const uint64_t sum = static_cast<uint64_t>(a) + b;
    return static_cast<uint32_t>(std::min<uint64_t>(sum, std::numeric_limits<uint32_t>::max()));
  };
  counts->n_safe = add(counts->n_safe, n_safe);
  counts->n_unsafe = add(counts->n_unsafe, n_unsafe);
}

/// Takes one more voxel of a column of the 2-D map into its votes: their sum, as [CORE], or those
/// of the worst voxel. An empty voxel changes nothing.
inline void joinColumn(const Counts& voxel, bool sum, Counts* column) {
  if (voxel.empty()) return;
  if (sum) {
    addVotes(voxel.n_safe, voxel.n_unsafe, column);
  } else if (column->empty() || isWorse(voxel, *column)) {
    *column = voxel;
  }
}

/// Adds one vote under a sliding cap: while n_safe + n_unsafe > cap, the side that did not get the
/// vote loses one, or the side that did where the other has none. So one more unsafe vote never
/// raises P(safe), and the other way round. Differs from [CORE]: raw counts need as many contrary
/// votes as there is history. cap 0 means none.
void addFrameVote(bool safe, uint32_t cap, Counts* counts);

/// Brings n_safe + n_unsafe down to a cap with about the same P(safe), never a higher one; cap 0
/// means none.
void limitVotes(uint32_t cap, Counts* counts);

/// Takes one unsafe vote away: the voxel was seen through.
void contradict(Counts* counts);

/// Takes half of the votes away, so that P(safe) never rises: one unsafe vote fades to nothing, the
/// safe votes beside it fade in proportion.
/// @param keep_safe of a voxel that is safe already only the unsafe votes fade.
void fadeVotes(bool keep_safe, Counts* counts);

}  // namespace core_perception
