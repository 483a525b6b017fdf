// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/vote_rule.h"

namespace core_perception {

bool isSafe(const Counts& counts, double tau) {
  return static_cast<double>(counts.n_safe) >= tau * static_cast<double>(counts.total());
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
