// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/vote_rule.h"

#include <algorithm>
#include <limits>

namespace core_perception {
namespace {

uint32_t addSaturated(uint32_t a, uint32_t b) {
  const uint64_t sum = static_cast<uint64_t>(a) + b;
  return static_cast<uint32_t>(std::min<uint64_t>(sum, std::numeric_limits<uint32_t>::max()));
}

}  // namespace

bool isSafe(const Counts& counts, double tau) {
  return static_cast<double>(counts.n_safe) >= tau * static_cast<double>(counts.total());
}

bool isWorse(const Counts& a, const Counts& b) {
  // a_s / a_total < b_s / b_total  <=>  a_s b_u < b_s a_u
  const uint64_t left = static_cast<uint64_t>(a.n_safe) * b.n_unsafe;
  const uint64_t right = static_cast<uint64_t>(b.n_safe) * a.n_unsafe;
  return left < right || (left == right && a.total() > b.total());
}

void addVotes(uint32_t n_safe, uint32_t n_unsafe, Counts* counts) {
  counts->n_safe = addSaturated(counts->n_safe, n_safe);
  counts->n_unsafe = addSaturated(counts->n_unsafe, n_unsafe);
}

void joinColumn(const Counts& voxel, bool sum, Counts* column) {
  if (voxel.empty()) return;
  if (sum) {
    addVotes(voxel.n_safe, voxel.n_unsafe, column);
  } else if (column->empty() || isWorse(voxel, *column)) {
    *column = voxel;
  }
}

void addFrameVote(bool safe, uint32_t cap, Counts* counts) {
  addVotes(safe ? 1 : 0, safe ? 0 : 1, counts);
  if (cap == 0) return;
  uint32_t& voted = safe ? counts->n_safe : counts->n_unsafe;
  uint32_t& other = safe ? counts->n_unsafe : counts->n_safe;
  while (counts->total() > cap) --(other > 0 ? other : voted);
}

void limitVotes(uint32_t cap, Counts* counts) {
  const uint64_t total = counts->total();
  if (cap == 0 || total <= cap) return;
  counts->n_safe = static_cast<uint32_t>(counts->n_safe * static_cast<uint64_t>(cap) / total);
  counts->n_unsafe = cap - counts->n_safe;
}

void contradict(Counts* counts) {
  if (counts->n_unsafe > 0) --counts->n_unsafe;
}

void fadeVotes(bool keep_safe, Counts* counts) {
  if (counts->n_unsafe == 0) return;
  const uint32_t left = counts->n_unsafe / 2;
  if (!keep_safe) {
    counts->n_safe =
        static_cast<uint32_t>(static_cast<uint64_t>(counts->n_safe) * left / counts->n_unsafe);
  }
  counts->n_unsafe = left;
}

}  // namespace core_perception
