// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <limits>
#include <memory>
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
  uint32_t n_metric;
  uint16_t metric_cause = 2;
};

bool wasSeen(const VoteMap& map, int x, int y) {
  int n = 1;
  const Column* row = map.findRow(x, y, &n);
  return row != nullptr && row->seen;
}

void addFrame(const std::vector<Pixels>& pixels, VoteMap* map,
              const CauseTable& causes = CauseTable()) {
  FrameVotes votes(0.2, -1.0, 3.0);
  votes.start(Eigen::Vector3d(0.1, 0.1, 0.1), 5.0);
  PointRow row;
  row.resize(static_cast<int>(pixels.size()));
  for (const Pixels& p : pixels) {
    row.depth_m[row.end] = 1.0f;
    row.dx_m[row.end] = static_cast<float>(p.x_m - 0.1);
    row.dy_m[row.end] = static_cast<float>(p.y_m - 0.1);
    row.dz_m[row.end] = static_cast<float>(p.z_m - 0.1);
    ++row.end;
  }
  PixelRow<int32_t> voxels;
  votes.locate(row, FloorBand(), &voxels);
  for (size_t i = 0; i < pixels.size(); ++i) {
    const Eigen::Vector3d d_m(pixels[i].x_m - 0.1, pixels[i].y_m - 0.1, pixels[i].z_m - 0.1);
    const int32_t voxel = votes.locatePoint(d_m, 1.0, FloorBand());
    ASSERT_GT(voxel, FrameVotes::kNoVoxel);
    ASSERT_TRUE(voxels[i] == voxel || voxels[i] == FrameVotes::kUndecided);
    FrameVotes::RowCounter counter(&votes, 3);
    counter.add(voxel, kSafeVote, pixels[i].n_safe, kNoCause);
    counter.add(voxel, kUnsafeVote, pixels[i].n_unsafe, 1);
    counter.add(voxel, kMetricVote, pixels[i].n_metric, pixels[i].metric_cause);
  }
  map->add(votes, causes);
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

TEST(VoteRule, fading_halves_and_never_raises_the_probability_of_safe_of_what_is_not_safe) {
  std::mt19937 random(10);
  for (int round = 0; round < 20000; ++round) {
    const Counts before{static_cast<uint32_t>(random() >> (random() % 31)),
                        static_cast<uint32_t>(random() >> (random() % 31))};
    Counts all = before, unsafe = before;
    fadeVotes(false, &all);
    fadeVotes(true, &unsafe);
    EXPECT_EQ(all.n_unsafe, before.n_unsafe / 2);
    EXPECT_EQ(unsafe, (Counts{before.n_safe, before.n_unsafe / 2}));
    if (before.n_unsafe == 0) {
      EXPECT_EQ(all, before);
    } else if (all.empty()) {
      EXPECT_EQ(before.n_unsafe, 1u);
    } else {
      EXPECT_LE(probability(all), probability(before));
      EXPECT_LE(all.n_safe, before.n_safe / 2);
    }
  }
}

/// A map in which cause 1 (of voxels at floor level) is at rest and cause 2 (of obstacles) moves.
class FadingVotes : public testing::Test {
 protected:
  FadingVotes() : causes_({"person"}), map_(0.2, RangeParams(), VoteParams()) {
    causes_.intern(kNotSafeRule, "");
    causes_.intern(kNotSafeRule, "wall");
    causes_.intern(kMetricRule, "person");
  }
  void see(double stamp_s, const std::vector<Pixels>& pixels) {
    addFrame(pixels, &map_, causes_);
    map_.fade(stamp_s);
  }
  Counts columnAt(int x, int y) const {
    const Column* column = map_.find(x, y);
    return column == nullptr ? Counts() : column->counts;
  }

  const double half_life_s_ = VoteParams().mobile_half_life_s;
  const Pixels floor_{1.1, 1.1, 0.05, 50, 0, 0}, person_{1.1, 1.1, 0.5, 0, 0, 50};
  const Pixels elsewhere_{3.1, 3.1, 0.05, 50, 0, 0};
  CauseTable causes_;
  VoteMap map_;
};

TEST_F(FadingVotes, what_moves_loses_half_its_weight_every_half_life_and_is_unknown_then) {
  for (int k = 0; k < 10; ++k) see(1.0, {floor_});
  for (int k = 0; k < 10; ++k) see(2.0 + 0.1 * k, {floor_, person_});
  ASSERT_EQ(columnAt(5, 5), (Counts{0, 10}));
  const double last_s = 2.9;
  for (const uint32_t left : {10u, 5u, 2u, 1u}) {
    const double age = left == 10u ? 0.0 : left == 5u ? 1.0 : left == 2u ? 2.0 : 3.0;
    map_.fade(last_s + (age + 0.01) * half_life_s_);
    EXPECT_EQ(columnAt(5, 5), (Counts{0, left})) << left;
    map_.fade(last_s + (age + 0.99) * half_life_s_);
    EXPECT_EQ(columnAt(5, 5), (Counts{0, left})) << left;
  }
  map_.fade(last_s + 4.01 * half_life_s_);
  EXPECT_EQ(map_.find(5, 5), nullptr) << "the floor of before does not come back by itself";
  EXPECT_TRUE(wasSeen(map_, 5, 5));
  EXPECT_FALSE(wasSeen(map_, 6, 5));
  EXPECT_EQ(map_.tree().getNumLeafNodes(), 0u);
  EXPECT_FALSE(map_.isMobile({5, 5, 2}));
}

TEST_F(FadingVotes, time_runs_by_stamps_that_may_repeat_go_back_or_pause) {
  for (int k = 0; k < 10; ++k) see(100.0, {person_});
  for (int k = 0; k < 50; ++k) map_.fade(100.0);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 10}));
  map_.fade(100.0 - 0.1 * half_life_s_);
  map_.fade(100.0 + 0.8 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 10}));
  map_.fade(40.0);  // from here time starts anew
  map_.fade(40.0 + 0.99 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 10}));
  map_.fade(40.0 + 1.01 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 5}));
  map_.fade(5e9);  // a pause
  EXPECT_EQ(map_.find(5, 5), nullptr);
}

TEST_F(FadingVotes, floor_is_unknown_until_it_is_seen_after_the_person_has_faded) {
  for (int k = 0; k < 10; ++k) see(1.0, {floor_, person_});
  see(2.0, {floor_});  // perhaps of the part of the column that the image held
  map_.fade(1000.0);
  EXPECT_EQ(map_.find(5, 5), nullptr);
  see(1001.0, {floor_});
  EXPECT_EQ(columnAt(5, 5), (Counts{1, 0}));
}

TEST_F(FadingVotes, what_stands_at_rest_never_fades_beside_a_person_or_in_its_place) {
  const Pixels wall{1.1, 1.1, 0.7, 0, 50, 0};  // above the person, so that the column holds both
  for (int k = 0; k < 10; ++k) see(1.0, {floor_, person_, wall});
  map_.fade(1e6);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 10}));
  map_.clear();
  for (int k = 0; k < 10; ++k) see(1.0, {person_});
  see(1.1, {{1.1, 1.1, 0.5, 0, 50, 0}});  // the same voxel: not a person
  map_.fade(1e6);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 10}));
}

TEST_F(FadingVotes, edges_and_flicker_without_a_label_are_part_of_the_person_and_the_wall_is_not) {
  const uint16_t unlabelled = causes_.intern(kMetricRule, "");
  const Pixels beside{1.1, 1.3, 0.5, 0, 0, 50, unlabelled};
  const Pixels farther{1.1, 1.7, 0.5, 0, 0, 50, unlabelled};
  const Pixels between{1.1, 1.5, 0.5, 0, 0, 50, unlabelled};
  Pixels flicker = person_;
  flicker.metric_cause = unlabelled;
  see(1.0, {person_, beside, between, farther});
  EXPECT_TRUE(map_.isMobile({5, 6, 2}));
  EXPECT_TRUE(map_.isMobile({5, 7, 2}));
  EXPECT_FALSE(map_.isMobile({5, 8, 2})) << "no chain";
  see(1.0 + 0.9 * half_life_s_, {flicker, beside, farther});
  map_.fade(1.0 + 1.8 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 2})) << "seen again, whatever it was called";
  EXPECT_FALSE(map_.isMobile({5, 8, 2}));
  map_.fade(1e6);
  EXPECT_EQ(map_.find(5, 5), nullptr);
  EXPECT_EQ(map_.find(5, 6), nullptr);
  EXPECT_EQ(columnAt(5, 8), (Counts{0, 2}));
}

TEST_F(FadingVotes, a_person_who_is_seen_again_starts_anew_and_one_above_the_band_fades_too) {
  for (int k = 0; k < 10; ++k) see(1.0, {person_, {1.1, 1.1, 1.5, 0, 0, 50}});
  map_.fade(1.0 + 1.5 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 5}));
  see(1.0 + 1.9 * half_life_s_, {person_});
  map_.fade(1.0 + 2.5 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 6}));
  map_.fade(1e6);
  EXPECT_EQ(map_.tree().getNumLeafNodes(), 0u);
}

TEST_F(FadingVotes, of_ground_that_is_safe_already_only_the_unsafe_votes_fade) {
  const Pixels feet{1.1, 1.1, 0.05, 0, 0, 50};
  for (int k = 0; k < 10; ++k) see(1.0, {floor_});
  for (int k = 0; k < 2; ++k) see(2.0, {feet});
  ASSERT_EQ(columnAt(5, 5), (Counts{8, 2}));
  map_.fade(2.0 + 1.01 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{8, 1}));
  map_.fade(2.0 + 2.01 * half_life_s_);
  EXPECT_EQ(columnAt(5, 5), (Counts{8, 0}));
}

TEST_F(FadingVotes, voxel_that_was_seen_through_belongs_to_nobody) {
  see(1.0, {person_});
  ASSERT_TRUE(map_.isMobile({5, 5, 2}));
  map_.contradictVoxel({5, 5, 2});
  EXPECT_FALSE(map_.isMobile({5, 5, 2}));
}

TEST_F(FadingVotes, half_life_zero_means_never) {
  VoteParams never;
  never.mobile_half_life_s = 0.0;
  VoteMap map(0.2, RangeParams(), never);
  addFrame({person_}, &map, causes_);
  map.fade(1.0);
  map.fade(1e9);
  ASSERT_NE(map.find(5, 5), nullptr);
  EXPECT_EQ(map.find(5, 5)->counts, (Counts{0, 1}));
}

TEST_F(FadingVotes, what_was_loaded_does_not_fade) {
  VoteMap saved(0.2, RangeParams(), VoteParams());
  addFrame({person_}, &saved, causes_);
  see(1.0, {person_});
  map_.load(saved.tree(), true, 0);
  map_.fade(1e9);
  EXPECT_EQ(columnAt(5, 5), (Counts{0, 1}));
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

TEST(VoteMap, cleared_box_takes_the_voxels_whose_centres_lie_in_it_and_nothing_else) {
  VoteMap map(0.2, RangeParams(), VoteParams());
  const Pixels floor{1.1, 1.1, 0.05, 9, 0, 0}, obstacle{1.1, 1.1, 0.5, 0, 0, 9};
  const Pixels lamp{1.1, 1.1, 1.5, 0, 9, 0}, beside{1.3, 1.1, 0.5, 0, 0, 9};
  for (int k = 0; k < 3; ++k) addFrame({floor, obstacle, lamp, beside}, &map);
  const uint64_t version = map.version();
  EXPECT_EQ(map.clearBox({1.11, 1.0, 0.0}, {1.2, 1.2, 9.0}), 0) << "its faces pass the centres";
  EXPECT_EQ(map.version(), version);
  EXPECT_EQ(map.clearBox({1.1, 1.1, 0.3}, {1.1, 1.1, 0.7}), 1) << "both ends included";
  EXPECT_GT(map.version(), version);
  EXPECT_EQ(map.find(5, 5)->counts, (Counts{3, 0})) << "the floor is left";
  EXPECT_EQ(map.counts({5, 5, 7}), (Counts{0, 3})) << "and the lamp";
  EXPECT_EQ(map.find(6, 5)->counts, (Counts{0, 3}));
  EXPECT_EQ(map.tree().getNumLeafNodes(), 3u);
  EXPECT_EQ(map.clearBox({1.0, 1.0, -1.0}, {1.2, 1.2, 3.0}), 2);
  EXPECT_EQ(map.find(5, 5), nullptr);
  EXPECT_TRUE(wasSeen(map, 5, 5));
}

/// A tree of five voxels, one of them above the span of the map, and a block of eight alike,
/// pruned.
std::unique_ptr<SemanticOcTree> makeSavedTree() {
  auto tree = std::make_unique<SemanticOcTree>(0.2);
  const auto set = [&tree](int x, int y, int z, uint32_t n_safe, uint32_t n_unsafe) {
    constexpr int k = SemanticOcTree::kKeyOffset;
    tree->touch(octomap::OcTreeKey(static_cast<uint16_t>(x + k), static_cast<uint16_t>(y + k),
                                   static_cast<uint16_t>(z + k)))
        ->setCounts(n_safe, n_unsafe);
  };
  set(1, 1, 1, 6, 4);
  set(2, 1, 1, 2, 8);
  set(3, 1, 1, 40, 60);
  set(4, 1, 1, 9, 0);
  set(5, 1, 20, 0, 5);
  for (int i = 0; i < 8; ++i) set(-4 + i % 2, -4 + i / 2 % 2, 2 + i / 4, 0, 3);
  tree->prune();
  EXPECT_EQ(tree->getNumLeafNodes(), 6u);
  return tree;
}

TEST(VoteMap, loaded_votes_come_under_the_cap_and_a_pruned_leaf_stands_for_all_its_voxels) {
  VoteMap map(0.2, RangeParams(), VoteParams());
  const uint64_t version = map.version();
  map.load(*makeSavedTree(), true, 7);
  EXPECT_GT(map.version(), version);
  EXPECT_EQ(map.counts({1, 1, 1}), (Counts{6, 4}));
  EXPECT_EQ(map.counts({2, 1, 1}), (Counts{2, 8}));
  EXPECT_EQ(map.counts({3, 1, 1}), (Counts{4, 6}));
  EXPECT_EQ(map.counts({4, 1, 1}), (Counts{9, 0}));
  EXPECT_EQ(map.counts({5, 1, 20}), Counts()) << "above the span";
  for (const int x : {-4, -3}) {
    for (const int y : {-4, -3}) {
      ASSERT_NE(map.find(x, y), nullptr);
      EXPECT_EQ(map.find(x, y)->counts, (Counts{0, 3}));
      EXPECT_EQ(map.find(x, y)->cause, 7);
      EXPECT_EQ(map.counts({x, y, 2}), (Counts{0, 3}));
      EXPECT_EQ(map.counts({x, y, 3}), (Counts{0, 3}));
    }
  }
  EXPECT_EQ(map.tree().getNumLeafNodes(), 12u);
  map.clearBox({-9, -9, -9}, {9, 9, 9});
  EXPECT_TRUE(wasSeen(map, -4, -4));
}

TEST(VoteMap, of_a_loaded_tree_only_what_is_not_safe_counts_where_so_asked) {
  VoteMap map(0.2, RangeParams(), VoteParams());
  map.load(*makeSavedTree(), false, 7);
  EXPECT_EQ(map.counts({1, 1, 1}), Counts()) << "safe by 6 to 4";
  EXPECT_EQ(map.counts({2, 1, 1}), (Counts{0, 8}));
  EXPECT_EQ(map.counts({3, 1, 1}), (Counts{0, 10}));
  EXPECT_EQ(map.find(4, 1), nullptr);
  EXPECT_EQ(map.tree().getNumLeafNodes(), 10u);
}

TEST(VoteMap, raw_counts_of_a_loaded_tree_stay_raw) {
  VoteParams vote;
  vote.votes = "pixel";
  VoteMap map(0.2, RangeParams(), vote);
  map.load(*makeSavedTree(), true, 7);
  EXPECT_EQ(map.counts({3, 1, 1}), (Counts{40, 60}));
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

/// Eight voxels that a prune makes one leaf of.
std::vector<Pixels> makeCube() {
  std::vector<Pixels> pixels;
  for (int i = 0; i < 8; ++i)
    pixels.push_back(
        {0.1 + 0.2 * (i & 1), 0.1 + 0.2 * (i >> 1 & 1), 0.1 + 0.2 * (i >> 2), 3, 1, 0});
  return pixels;
}

TEST(VoteMap, votes_go_on_after_others_have_moved_the_leaves_of_the_tree) {
  VoteParams vote;
  vote.votes = "pixel";
  vote.column = "sum";
  vote.metric_layer = false;
  VoteMap map(0.2, RangeParams(), vote);
  addFrame(makeCube(), &map);
  map.tree().prune();
  ASSERT_EQ(map.tree().getNumLeafNodes(), 1u);
  addFrame(makeCube(), &map);
  map.tree().prune();
  map.tree().expand();
  addFrame(makeCube(), &map);
  map.tree().erase({32768, 32768, 32768});
  addFrame(makeCube(), &map);
  ASSERT_EQ(map.tree().getNumLeafNodes(), 8u);
  for (int i = 0; i < 8; ++i) {
    const VoxelIndex voxel{i & 1, i >> 1 & 1, i >> 2};
    EXPECT_EQ(map.counts(voxel), (Counts{12, 4}));
    const auto key = [](int index) { return static_cast<octomap::key_type>(32768 + index); };
    const SemanticOcTreeNode* leaf = map.tree().find({key(voxel.x), key(voxel.y), key(voxel.z)});
    ASSERT_NE(leaf, nullptr);
    EXPECT_EQ((Counts{leaf->n_safe(), leaf->n_unsafe()}), (Counts{12, 4}));
  }
}

TEST(VoteMap, cause_is_that_of_the_first_unsafe_voxel_or_of_the_last_metric_one) {
  const auto seeColumn = [](const std::vector<VoteKind>& kinds) {
    VoteMap map(0.2, RangeParams(), VoteParams());
    FrameVotes votes(0.2, -1.0, 3.0);
    votes.start(Eigen::Vector3d(0.1, 0.1, 0.1), 5.0);
    for (size_t i = 0; i < kinds.size(); ++i) {
      const double dz_m = 0.4 - 0.2 * static_cast<double>(i);  // down through the border of a block
      const int32_t voxel = votes.locatePoint({0.0, 0.0, dz_m}, 1.0, FloorBand());
      FrameVotes::RowCounter(&votes, 1).add(voxel, kinds[i], 9, static_cast<uint16_t>(i));
    }
    map.add(votes);
    return map.find(0, 0)->cause;
  };
  EXPECT_EQ(seeColumn({kUnsafeVote, kUnsafeVote, kUnsafeVote, kUnsafeVote}), 0);
  EXPECT_EQ(seeColumn({kUnsafeVote, kMetricVote, kUnsafeVote, kMetricVote}), 3);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
