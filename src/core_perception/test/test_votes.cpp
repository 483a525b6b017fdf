// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "core_perception/vote_map.h"
#include "core_perception/vote_rule.h"

namespace core_perception {
namespace {

double probability(const Counts& counts) {
  return counts.empty() ? 0.5 : 1.0 * counts.n_safe / counts.total();
}

/// Votes of one frame: pixels in the voxel of a point.
struct Pixels {
  double x_m, y_m, z_m;
  uint32_t n_safe, n_unsafe;
  uint16_t n_metric;
};

void addFrame(const std::vector<Pixels>& pixels, VoteMap* map) {
  FrameVotes votes(0.2, -1.0, 3.0);
  votes.start(Eigen::Vector3d(0.1, 0.1, 0.1), 5.0);
  PointRow row;
  for (const Pixels& p : pixels) {
    row.depth_m.push_back(1.0f);
    row.dx_m.push_back(static_cast<float>(p.x_m - 0.1));
    row.dy_m.push_back(static_cast<float>(p.y_m - 0.1));
    row.dz_m.push_back(static_cast<float>(p.z_m - 0.1));
  }
  row.end = static_cast<int>(pixels.size());
  std::vector<int32_t> voxels;
  votes.locate(row, FloorBand(), &voxels);
  for (size_t i = 0; i < pixels.size(); ++i) {
    const Eigen::Vector3d d_m(pixels[i].x_m - 0.1, pixels[i].y_m - 0.1, pixels[i].z_m - 0.1);
    const int32_t voxel = votes.locatePoint(d_m, 1.0, FloorBand());
    ASSERT_GE(voxel, 0);
    ASSERT_TRUE(voxels[i] == voxel || voxels[i] == FrameVotes::kUndecided);
    VoxelTally& tally = votes.touch(voxel);
    tally.n_safe = pixels[i].n_safe;
    tally.n_unsafe = pixels[i].n_unsafe;
    tally.n_metric = pixels[i].n_metric;
    tally.cause = 1;
    tally.metric_cause = 2;
  }
  map->add(votes);
}

TEST(VoteRule, one_more_unsafe_vote_never_raises_the_probability_of_safe_and_the_other_way_round) {
  std::mt19937 random(8);
  for (int round = 0; round < 20000; ++round) {
    const uint32_t cap = random() % 3 == 0 ? 0 : 1 + random() % 12;
    const Counts before{static_cast<uint32_t>(random() % 15), static_cast<uint32_t>(random() % 15)};
    Counts after = before;
    const bool safe = random() % 2 == 0;
    addFrameVote(safe, cap, &after);
    if (before.empty()) continue;
    const double change = probability(after) - probability(before);
    EXPECT_GE(safe ? change : -change, 0.0);
    EXPECT_TRUE(cap == 0 || after.total() <= cap);
  }
}

TEST(VoteRule, limit_keeps_the_probability_and_never_raises_it) {
  std::mt19937 random(9);
  for (int round = 0; round < 20000; ++round) {
    const Counts before{static_cast<uint32_t>(random() >> (random() % 31)),
                        static_cast<uint32_t>(random() >> (random() % 31))};
    const uint32_t cap = random() % 20;
    Counts after = before;
    limitVotes(cap, &after);
    if (cap == 0 || before.total() <= cap) {
      EXPECT_TRUE(after == before);
      continue;
    }
    EXPECT_EQ(after.total(), cap);
    EXPECT_LE(probability(after), probability(before));
    EXPECT_GT(probability(after), probability(before) - 1.0 / cap);
  }
}

TEST(VoteRule, capped_cell_changes_sides_after_half_the_cap_and_one) {
  Counts counts{10, 0};
  int frames = 0;
  while (isSafe(counts, 0.5)) {
    addFrameVote(false, 10, &counts);
    ++frames;
  }
  EXPECT_EQ(frames, 6);
}

TEST(VoteRule, raw_counts_stop_instead_of_wrapping) {
  Counts counts{std::numeric_limits<uint32_t>::max() - 1, 0};
  addVotes(5, 3, &counts);
  EXPECT_EQ(counts.n_safe, std::numeric_limits<uint32_t>::max());
  EXPECT_EQ(counts.n_unsafe, 3u);
}

TEST(VoteRule, half_is_safe_and_zero_votes_are_not_negative) {
  EXPECT_TRUE(isSafe({1, 1}, 0.5));
  EXPECT_FALSE(isSafe({1, 2}, 0.5));
  Counts counts{3, 0};
  contradict(&counts);
  EXPECT_EQ(counts, (Counts{3, 0}));
}

TEST(VoteMap, paper_sums_the_pixels_of_the_whole_band) {
  VoteParams vote;
  vote.votes = "pixel";
  vote.column = "sum";
  vote.metric_layer = false;
  VoteMap map(0.2, RangeParams(), vote);
  for (int k = 0; k < 3; ++k)
    addFrame({{1.0, 1.0, 0.1, 7, 2, 0}, {1.0, 1.0, 0.5, 0, 4, 0}, {1.0, 1.0, 2.0, 0, 99, 0}}, &map);
  ASSERT_NE(map.find(5, 5), nullptr);
  EXPECT_EQ(map.find(5, 5)->counts, (Counts{21, 18})) << "what hangs above the band does not count";
}

TEST(VoteMap, core_takes_one_vote_a_frame_and_the_worst_voxel) {
  VoteMap map(0.2, RangeParams(), VoteParams());
  for (int k = 0; k < 3; ++k) addFrame({{1.1, 1.1, 0.05, 500, 3, 0}}, &map);
  EXPECT_EQ(map.find(5, 5)->counts, (Counts{3, 0}));
  addFrame({{1.1, 1.1, 0.5, 0, 0, 40}, {1.1, 1.1, 0.05, 500, 3, 0}}, &map);
  EXPECT_EQ(map.find(5, 5)->counts, (Counts{0, 1}));
  EXPECT_EQ(map.find(5, 5)->cause, 2);
  map.contradictVoxel({5, 5, 2});
  EXPECT_EQ(map.find(5, 5)->counts, (Counts{4, 0}));
  EXPECT_EQ(map.tree().getNumLeafNodes(), 1u);
}

TEST(VoteMap, fewer_metric_points_than_asked_are_nothing) {
  VoteMap map(0.2, RangeParams(), VoteParams());
  addFrame({{1.1, 1.1, 0.5, 0, 0, 2}}, &map);
  EXPECT_EQ(map.find(5, 5), nullptr);
  EXPECT_EQ(map.tree().size(), 0u);
}

TEST(VoteMap, negative_coordinates_have_their_own_cells) {
  VoteMap map(0.2, RangeParams(), VoteParams());
  addFrame({{-0.1, -0.1, 0.05, 5, 0, 0}, {0.1, 0.1, 0.05, 0, 5, 0}}, &map);
  EXPECT_EQ(map.find(-1, -1)->counts, (Counts{1, 0}));
  EXPECT_EQ(map.find(0, 0)->counts, (Counts{0, 1}));
  EXPECT_EQ(map.find(-33, -33), nullptr);
  map.clear();
  EXPECT_EQ(map.find(0, 0), nullptr);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
