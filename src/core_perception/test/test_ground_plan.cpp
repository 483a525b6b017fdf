// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>

#include "core_perception/ground_plan.h"
#include "core_perception/semantic_map.h"
#include "scene.h"

namespace core_perception {
namespace {

constexpr double kResolution_m = 0.2;

octomap::OcTreeKey makeKey(int x, int y, int z) {
  return octomap::OcTreeKey(static_cast<uint16_t>(32768 + x), static_cast<uint16_t>(32768 + y),
                            static_cast<uint16_t>(32768 + z));
}

int8_t cellAt(const GroundPlan& plan, int x, int y) {
  const int ix = x - plan.frame.origin.x, iy = y - plan.frame.origin.y;
  if (ix < 0 || iy < 0 || ix >= plan.frame.width || iy >= plan.frame.height) return -1;
  return plan.cells[static_cast<size_t>(iy) * plan.frame.width + ix];
}

VoteParams makeParams(const std::string& column) {
  VoteParams params;
  params.column = column;
  return params;
}

TEST(GroundPlan, columns_are_decided_as_in_the_2d_map) {
  for (const char* column : {"worst", "sum"}) {
    SemanticMapParams params;
    params.vote.column = column;
    if (params.vote.column == "sum") {  // as profile paper
      params.vote.votes = "pixel";
      params.vote.count_cap = 0;
      params.vote.metric_layer = false;
      params.vote.free_space_clearing = false;
    }
    SemanticMap map(params);
    for (int k = 1; k <= 6; ++k)
      map.update(makeConeLine().render(0.1 * k, 0.4 * k, 0.1 * k, 0.2 * (k % 3)), makeConeRules());
    const VoteMap& votes = map.votes();
    const HeightBand band{votes.bandMin(), votes.bandMax()};
    const GroundPlan plan =
        projectToGround(takeSnapshot(map.votes().tree()), band, params.vote, {});
    int n[3] = {0, 0, 0};
    for (int y = -60; y <= 60; ++y) {
      for (int x = -60; x <= 60; ++x) {
        const Column* expected = votes.find(x, y);
        const int decision = expected == nullptr                         ? -1
                             : isSafe(expected->counts, params.vote.tau) ? 0
                                                                         : 100;
        ASSERT_EQ(cellAt(plan, x, y), decision) << column << " " << x << " " << y;
        ++n[decision < 0 ? 0 : decision == 0 ? 1 : 2];
      }
    }
    EXPECT_GT(n[0], 100);
    EXPECT_GT(n[1], 100);
    EXPECT_GT(n[2], 5);
  }
}

TEST(GroundPlan, pruned_cubes_count_for_every_column_and_layer_they_cover) {
  for (const char* column : {"worst", "sum"}) {
    SemanticOcTree tree(kResolution_m);
    for (int i = 0; i < 64; ++i) tree.touch(makeKey(i % 4, i / 4 % 4, i / 16))->setCounts(1, 0);
    tree.touch(makeKey(1, 1, 5))->setCounts(0, 3);
    const HeightBand band{0, 8};
    const GroundPlan whole = projectToGround(takeSnapshot(tree), band, makeParams(column), {});
    tree.prune();
    ASSERT_LT(tree.getNumLeafNodes(), 20u);
    const GroundPlan pruned = projectToGround(takeSnapshot(tree), band, makeParams(column), {});
    EXPECT_EQ(pruned.cells, whole.cells);
    // Four safe votes against three in the sum.
    EXPECT_EQ(cellAt(pruned, 1, 1), std::string(column) == "sum" ? 0 : 100);
    EXPECT_EQ(cellAt(pruned, 3, 3), 0);
    EXPECT_EQ(pruned.cells.size(), 16u);
  }
}

TEST(GroundPlan, voxels_above_the_band_do_not_mark_the_floor) {
  SemanticOcTree tree(kResolution_m);
  tree.touch(makeKey(0, 0, 0))->setCounts(1, 0);
  tree.touch(makeKey(0, 0, 9))->setCounts(0, 9);
  tree.touch(makeKey(5, 0, 9))->setCounts(0, 9);
  const GroundPlan plan =
      projectToGround(takeSnapshot(tree), HeightBand{0, 4}, makeParams("worst"), {});
  EXPECT_EQ(cellAt(plan, 0, 0), 0);
  EXPECT_EQ(plan.cells.size(), 1u);
}

TEST(GroundPlan, barriers_of_remembered_objects_are_in_it_also_where_no_floor_was_seen) {
  SemanticOcTree tree(kResolution_m);
  for (int x = 0; x < 20; ++x) tree.touch(makeKey(x, 0, 0))->setCounts(9, 0);
  Region barrier, slow;
  barrier.parts = {{{3.1, -1.1}, {3.1, 1.1}}};
  barrier.radius_m = 0.15;
  slow.parts = {{{1.1, 0.1}}};
  slow.radius_m = 0.5;
  slow.slow = true;
  const GroundPlan plan =
      projectToGround(takeSnapshot(tree), HeightBand{0, 4}, makeParams("worst"), {barrier, slow});
  EXPECT_EQ(cellAt(plan, 15, 0), 100);
  EXPECT_EQ(cellAt(plan, 15, 5), 100);
  EXPECT_EQ(cellAt(plan, 15, -6), 100);
  EXPECT_EQ(cellAt(plan, 5, 0), 0);
  EXPECT_EQ(cellAt(plan, 5, 3), -1);
}

TEST(GroundPlan, empty_map_gives_no_cell_and_an_immense_one_is_refused) {
  SemanticOcTree tree(kResolution_m);
  EXPECT_TRUE(
      projectToGround(takeSnapshot(tree), HeightBand{0, 4}, makeParams("worst"), {}).cells.empty());
  tree.touch(makeKey(-30000, -30000, 0))->setCounts(1, 0);
  tree.touch(makeKey(30000, 30000, 0))->setCounts(1, 0);
  EXPECT_THROW(projectToGround(takeSnapshot(tree), HeightBand{0, 4}, makeParams("worst"), {}),
               std::length_error);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
