// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/vote_map.h"

namespace core_perception {

/// Notes whose an unsafe vote is.
void VoteMap::noteMover(const VoxelIndex& voxel, uint16_t cause, const CauseTable& causes) {
  if (vote_.mobile_half_life_s <= 0.0) return;
  const bool labelled = cause < causes.size() && !causes.at(cause).class_name.empty();
  mobile_.note(voxel, causes.isMobile(cause) ? Mover::kMoves
                      : labelled             ? Mover::kAtRest
                                             : Mover::kUnknown);
}

/// The unlabelled edges of what moves move with it.
void VoteMap::spreadMovers(const FrameVotes& votes, const CauseTable& causes) {
  mobile_.spread([&](const VoxelIndex& voxel) {
    const VoxelTally* tally = votes.find(voxel);
    if (tally == nullptr) return false;
    const bool metric = isMetric(*tally);
    if (!metric && (tally->n_unsafe() == 0 || tally->n_unsafe() < tally->n_safe())) return false;
    const uint16_t cause = tally->cause[metric ? kMetricVote : kUnsafeVote];
    return cause < causes.size() && causes.at(cause).class_name.empty();
  });
}

bool VoteMap::isMobile(const VoxelIndex& voxel) const { return mobile_.has(voxel); }

void VoteMap::fade(double stamp_s) {
  mobile_.age(stamp_s, vote_.mobile_half_life_s,
              [this](const VoxelIndex& voxel, int n) { return fadeVoxel(voxel, n); });
}

/// @returns whether unsafe votes are left.
bool VoteMap::fadeVoxel(const VoxelIndex& voxel, int half_lives) {
  Counts left = counts(voxel);
  if (left.n_unsafe == 0) return false;
  const bool was_safe = isSafe(left, vote_.tau);
  for (int i = 0; i < half_lives; ++i) fadeVotes(was_safe, &left);
  ++version_;
  setVoxel(voxel, left);
  if (isInBand(voxel.z)) {
    if (left.empty()) dropStaleFloor(voxel);
    derive(touchPlace(voxel.x, voxel.y));
  }
  return left.n_unsafe > 0;
}

/// Where something faded the floor is unknown until it is seen again: what was seen of the column
/// meanwhile may have been a part of it.
void VoteMap::dropStaleFloor(const VoxelIndex& gone) {
  const Place place = touchPlace(gone.x, gone.y);
  for (int z = band_min_; z <= band_max_; ++z) {
    const Counts& counts = place.voxel(z - band_min_).counts;
    if (!counts.empty() && isSafe(counts, vote_.tau)) setVoxel({gone.x, gone.y, z}, Counts());
  }
}

}  // namespace core_perception
