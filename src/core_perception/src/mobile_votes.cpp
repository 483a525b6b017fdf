// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/mobile_votes.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <vector>

namespace core_perception {
namespace {

constexpr int kOffset = 1 << 20;  // voxels to each side of the origin; the tree has fewer
constexpr uint64_t kMask = (1 << 21) - 1;
constexpr int kRings = 2;  // voxels without a label around those with one

}  // namespace

uint64_t MobileVotes::pack(const VoxelIndex& voxel) {
  const auto part = [](int index) { return static_cast<uint64_t>(index + kOffset) & kMask; };
  return part(voxel.x) << 42 | part(voxel.y) << 21 | part(voxel.z);
}

VoxelIndex MobileVotes::unpack(uint64_t key) {
  const auto part = [key](int shift) { return static_cast<int>(key >> shift & kMask) - kOffset; };
  return {part(42), part(21), part(0)};
}

void MobileVotes::note(const VoxelIndex& voxel, Mover mover) {
  if (mover == Mover::kMoves) {
    Age& age = voxels_[pack(voxel)];
    age.labelled = age.fresh = true;
  } else if (mover == Mover::kAtRest) {
    if (!voxels_.empty()) voxels_.erase(pack(voxel));
  } else if (!voxels_.empty()) {
    const auto it = voxels_.find(pack(voxel));
    if (it != voxels_.end()) it->second.fresh = true;
  }
}

void MobileVotes::spread(const std::function<bool(const VoxelIndex&)>& is_unlabelled) {
  std::vector<uint64_t> edge, beside;
  for (const auto& entry : voxels_) {
    if (entry.second.labelled && entry.second.fresh) edge.push_back(entry.first);
  }
  for (int ring = 0; ring < kRings; ++ring) {
    beside.clear();
    for (const uint64_t key : edge) {
      const VoxelIndex v = unpack(key);
      for (int i = 0; i < 27; ++i) {
        const VoxelIndex other{v.x + i / 9 - 1, v.y + i / 3 % 3 - 1, v.z + i % 3 - 1};
        if (is_unlabelled(other)) beside.push_back(pack(other));
      }
    }
    std::sort(beside.begin(), beside.end());
    beside.erase(std::unique(beside.begin(), beside.end()), beside.end());
    for (const uint64_t key : beside) voxels_[key].fresh = true;
    edge.swap(beside);
  }
}

void MobileVotes::age(double stamp_s, double half_life_s, const Halve& halve) {
  constexpr double kMostTimes = 64.0;  // nothing is left of 2^32 votes by then
  for (auto it = voxels_.begin(); it != voxels_.end();) {
    Age& age = it->second;
    if (age.fresh || stamp_s < age.since_s) age.since_s = stamp_s;
    age.fresh = false;
    const double times = std::floor((stamp_s - age.since_s) / half_life_s);
    age.since_s += times * half_life_s;
    const bool stays =
        times < 1.0 || halve(unpack(it->first), static_cast<int>(std::min(times, kMostTimes)));
    it = stays ? std::next(it) : voxels_.erase(it);
  }
}

}  // namespace core_perception
