// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>

#include "core_perception/geometry2d.h"
#include "core_perception/ground_regions.h"
#include "scene.h"

namespace core_perception {
namespace {

HeldInstance makeHeld(uint32_t id, const Point2& centre, double edge_m = 0.3,
                      const std::string& name = "cone") {
  HeldInstance held;
  held.id = held.cluster = id;
  held.class_name = name;
  held.footprint = makeSquare(centre, edge_m);
  held.confirmed = true;
  return held;
}

Predicate unsafe(SpatialOperator spatial_operator, double radius_m = 0.0) {
  return makePredicate(spatial_operator, "cone", Verdict::kUnsafe, radius_m);
}

Predicate sparing(SpatialOperator spatial_operator, const std::set<uint32_t>& exempt) {
  Predicate predicate = unsafe(spatial_operator);
  predicate.exempt_instances = exempt;
  return predicate;
}

/// Numbers of the objects, or clusters, that regions were made for.
std::multiset<uint32_t> numbersOf(const std::vector<Region>& regions) {
  std::multiset<uint32_t> numbers;
  for (const Region& region : regions) numbers.insert(region.cause.instance_id);
  return numbers;
}

TEST(Geometry, hull_contains_every_point_and_turns_left) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> coordinate(-5.0, 5.0);
  for (int round = 0; round < 50; ++round) {
    std::vector<Point2> points(3 + round);
    for (Point2& p : points) p = {coordinate(random), coordinate(random)};
    const Polygon hull = computeConvexHull(points);
    for (const Point2& p : points) EXPECT_LE(computeDistance(p, hull), 1e-9);
    double area = 0.0;
    for (size_t i = 0; i < hull.size(); ++i) {
      const Point2 &a = hull[i], &b = hull[(i + 1) % hull.size()];
      area += a.x * b.y - a.y * b.x;
    }
    EXPECT_GT(area, 0.0);
  }
}

TEST(Geometry, hull_of_few_or_equal_points_is_a_point_or_a_segment) {
  EXPECT_EQ(computeConvexHull({{1, 2}, {1, 2}, {1, 2}}).size(), 1u);
  EXPECT_EQ(computeConvexHull({{0, 0}, {1, 1}, {2, 2}}).size(), 2u);
  EXPECT_DOUBLE_EQ(computeWidth({{0, 0}, {3, 0}}), 0.0);
  EXPECT_DOUBLE_EQ(computeDistance(Point2{1.0, 2.0}, Polygon{{0, 0}, {3, 0}}), 2.0);
}

TEST(Geometry, distance_of_polygons_is_zero_when_they_cross_without_a_corner_inside) {
  const Polygon wide{{-3, -1}, {3, -1}, {3, 1}, {-3, 1}}, high{{-1, -3}, {1, -3}, {1, 3}, {-1, 3}};
  EXPECT_DOUBLE_EQ(computeDistance(wide, high), 0.0);
  EXPECT_DOUBLE_EQ(computeDistance(makeSquare({0, 0}, 2), makeSquare({5, 0}, 2)), 3.0);
  EXPECT_DOUBLE_EQ(computeDistance(makeSquare({0, 0}, 4), makeSquare({0.5, 0}, 1)), 0.0);
}

TEST(Geometry, simplified_hull_keeps_the_number_of_corners_and_most_of_the_area) {
  Polygon circle;
  for (int i = 0; i < 100; ++i) circle.push_back({std::cos(0.0628 * i), std::sin(0.0628 * i)});
  const Polygon few = simplifyHull(computeConvexHull(circle), 32);
  EXPECT_EQ(few.size(), 32u);
  for (const Point2& p : circle) EXPECT_LT(computeDistance(p, few), 0.03);
}

TEST(Regions, cluster_is_single_link_within_one_class) {
  std::vector<HeldInstance> all{makeHeld(1, {0, 0}), makeHeld(2, {2, 0}), makeHeld(3, {4, 0}),
                                makeHeld(4, {9, 0}), makeHeld(5, {1, 0}, 0.3, "box")};
  all.push_back(makeHeld(6, {0, 1}));
  all.back().confirmed = false;
  labelClusters(2.5, &all);
  std::vector<uint32_t> numbers;
  for (const HeldInstance& held : all) numbers.push_back(held.cluster);
  EXPECT_EQ(numbers, (std::vector<uint32_t>{1, 1, 1, 4, 5, 6}));
}

TEST(Regions, between_is_as_thick_as_asked_even_for_objects_in_a_line) {
  InstanceParams params;
  std::vector<HeldInstance> all{makeHeld(1, {0, 0}, 0.02), makeHeld(2, {2, 0}, 0.02)};
  labelClusters(params.between_max_gap_m, &all);
  const auto regions = buildRegions(all, {unsafe(SpatialOperator::kBetween)}, params, 0.2);
  ASSERT_EQ(regions.size(), 1u);
  EXPECT_EQ(regions[0].cause.rule, "BETWEEN(cone)");
  EXPECT_EQ(regions[0].cause.instance_id, 1u);
  EXPECT_NEAR(computeWidth(regions[0].parts[0]) + 2.0 * regions[0].radius_m, 0.3, 1e-12);
}

TEST(Regions, one_object_has_nothing_between) {
  EXPECT_TRUE(buildRegions({makeHeld(1, {0, 0})}, {unsafe(SpatialOperator::kBetween)},
                           InstanceParams(), 0.2)
                  .empty());
}

TEST(Regions, radius_comes_from_predicate_then_class_then_default) {
  InstanceParams params;
  const std::vector<HeldInstance> all{makeHeld(1, {0, 0})};
  const auto radius = [&](double asked) {
    return buildRegions(all, {unsafe(SpatialOperator::kAround, asked)}, params, 0.2).at(0).radius_m;
  };
  EXPECT_DOUBLE_EQ(radius(0.7), 0.7);
  EXPECT_DOUBLE_EQ(radius(0.0), params.default_radius_m);
  params.class_radius_m["cone"] = 1.3;
  EXPECT_DOUBLE_EQ(radius(0.0), 1.3);
}

TEST(Regions, extended_object_is_surrounded_cell_by_cell_and_its_hull_is_no_footprint) {
  HeldInstance wall = makeHeld(1, {0, 0}, 6.0);
  wall.cells = {{0, 0}, {0, 1}};
  EXPECT_TRUE(
      buildRegions({wall}, {unsafe(SpatialOperator::kNear)}, InstanceParams(), 0.2).empty());
  const auto around =
      buildRegions({wall}, {unsafe(SpatialOperator::kAround)}, InstanceParams(), 0.2);
  ASSERT_EQ(around.size(), 1u);
  EXPECT_EQ(around[0].parts.size(), 2u);
}

TEST(Regions, exempt_object_has_none_and_its_neighbour_keeps_its_own) {
  const std::vector<HeldInstance> all{makeHeld(1, {0, 0}), makeHeld(2, {2, 0})};
  for (const auto kind : {SpatialOperator::kNear, SpatialOperator::kAround}) {
    const auto numbers = [&](const std::vector<Predicate>& predicates) {
      return numbersOf(buildRegions(all, predicates, InstanceParams(), 0.2));
    };
    EXPECT_EQ(numbers({sparing(kind, {})}), (std::multiset<uint32_t>{1, 2}));
    EXPECT_EQ(numbers({sparing(kind, {1})}), (std::multiset<uint32_t>{2}));
    EXPECT_EQ(numbers({sparing(kind, {7})}), (std::multiset<uint32_t>{1, 2}));
    EXPECT_EQ(numbers({sparing(kind, {1}), unsafe(kind)}), (std::multiset<uint32_t>{1, 2, 2}))
        << "the other predicate speaks of it still";
  }
}

TEST(Regions, between_spares_a_cluster_only_when_all_its_members_are_exempt) {
  InstanceParams params;
  std::vector<HeldInstance> all{makeHeld(1, {0, 0}), makeHeld(2, {2, 0}), makeHeld(3, {4, 0}),
                                makeHeld(5, {0, 9}), makeHeld(6, {2, 9})};
  labelClusters(params.between_max_gap_m, &all);
  const auto build = [&](const std::set<uint32_t>& exempt) {
    return buildRegions(all, {sparing(SpatialOperator::kBetween, exempt)}, params, 0.2);
  };
  EXPECT_EQ(numbersOf(build({})), (std::multiset<uint32_t>{1, 5}));
  EXPECT_EQ(numbersOf(build({1, 2, 3})), (std::multiset<uint32_t>{5}));
  EXPECT_EQ(numbersOf(build({5, 6})), (std::multiset<uint32_t>{1}));
  const std::vector<Region> whole = build({}), partly = build({1, 3, 5});
  ASSERT_EQ(partly.size(), whole.size());
  for (const Point2& end : {Point2{-0.1, 0.0}, Point2{4.1, 0.0}})
    EXPECT_TRUE(contains(partly[0].parts[0], end)) << "the hull of all, the exempt included";
}

TEST(Regions, exemptions_take_away_what_they_list_and_nothing_else) {
  const InstanceParams params;
  std::mt19937 random(3);
  std::uniform_real_distribution<double> coordinate(-6.0, 6.0);
  for (int round = 0; round < 300; ++round) {
    std::vector<HeldInstance> all;
    std::set<uint32_t> exempt;
    for (uint32_t id = 1; id <= 12; ++id) {
      const std::string name = random() % 4 == 0 ? "box" : "cone";
      all.push_back(makeHeld(id, {coordinate(random), coordinate(random)}, 0.3, name));
      all.back().confirmed = random() % 5 != 0;
      if (random() % 3 != 0) exempt.insert(id);
    }
    labelClusters(params.between_max_gap_m, &all);
    for (const auto kind :
         {SpatialOperator::kNear, SpatialOperator::kAround, SpatialOperator::kBetween}) {
      // A cluster stays where one that is not listed keeps it; any other object by itself.
      std::multiset<uint32_t> expected;
      for (const HeldInstance& held : all) {
        if (held.class_name != "cone" || !held.confirmed) continue;
        int members = 0, unlisted = 0;
        for (const HeldInstance& other : all) {
          if (other.class_name != "cone" || other.cluster != held.cluster) continue;
          ++members;
          unlisted += exempt.count(other.id) == 0 ? 1 : 0;
        }
        const bool between = kind == SpatialOperator::kBetween;
        if (between && held.id == held.cluster && members >= 2 && unlisted > 0)
          expected.insert(held.id);
        if (!between && exempt.count(held.id) == 0) expected.insert(held.id);
      }
      const std::vector<Predicate> predicates{sparing(kind, exempt)};
      const auto made = numbersOf(buildRegions(all, predicates, params, 0.2));
      EXPECT_EQ(made, expected) << "operator " << static_cast<int>(kind) << ", round " << round;
      for (const HeldInstance& held : all) {
        const bool between = kind == SpatialOperator::kBetween;
        const bool has_region =
            held.class_name == "cone" && made.count(between ? held.cluster : held.id) > 0;
        EXPECT_TRUE(!has_region || isUnsafeInstance(held, predicates, all)) << held.id;
      }
    }
  }
}

TEST(Regions, verdict_on_an_object_follows_its_exemptions) {
  std::vector<HeldInstance> all{makeHeld(1, {0, 0}), makeHeld(2, {2, 0}), makeHeld(3, {9, 0}),
                                makeHeld(4, {0, 1}, 0.3, "box")};
  labelClusters(2.5, &all);
  const auto verdicts = [&all](const std::vector<Predicate>& predicates) {
    std::vector<bool> unsafe_ones;
    for (const HeldInstance& held : all)
      unsafe_ones.push_back(isUnsafeInstance(held, predicates, all));
    return unsafe_ones;
  };
  using Verdicts = std::vector<bool>;
  const auto near = SpatialOperator::kNear, between = SpatialOperator::kBetween;
  EXPECT_EQ(verdicts({unsafe(near)}), (Verdicts{true, true, true, false}));
  EXPECT_EQ(verdicts({sparing(near, {1, 4})}), (Verdicts{false, true, true, false}));
  EXPECT_EQ(verdicts({sparing(between, {1, 3})}), (Verdicts{true, true, false, false}))
      << "the region of 2 reaches 1";
  EXPECT_EQ(verdicts({sparing(between, {1, 2})}), (Verdicts{false, false, true, false}));
  EXPECT_EQ(verdicts({sparing(near, {1, 2}), sparing(between, {2, 3})}),
            (Verdicts{true, true, true, false}));
  EXPECT_EQ(verdicts({sparing(SpatialOperator::kOn, {1, 2, 3})}),
            (Verdicts{true, true, true, false}))
      << "ON speaks of the class, not of objects";
  const Predicate safe = makePredicate(between, "cone", Verdict::kSafe);
  EXPECT_EQ(verdicts({unsafe(between), safe}), Verdicts(4, false));
}

TEST(Regions, cells_are_those_whose_square_reaches_into_the_region) {
  GridFrame grid;
  grid.origin = {-20, -20};
  grid.width = grid.height = 40;
  grid.resolution_m = 0.2;
  std::mt19937 random(2);
  std::uniform_real_distribution<double> coordinate(-3.0, 3.0);
  for (int round = 0; round < 20; ++round) {
    Region region;
    region.radius_m = 0.1 * (round % 5);
    region.parts = {computeConvexHull({{coordinate(random), coordinate(random)},
                                       {coordinate(random), coordinate(random)},
                                       {coordinate(random), coordinate(random)}})};
    std::set<size_t> visited;
    forEachCell(region, grid, [&](size_t i) { visited.insert(i); });
    for (size_t i = 0; i < 1600; ++i) {
      const Point2 centre{(static_cast<int>(i % 40) - 20 + 0.5) * 0.2,
                          (static_cast<int>(i / 40) - 20 + 0.5) * 0.2};
      const double gap = computeDistance(makeSquare(centre, 0.2), region.parts[0]);
      if (std::abs(gap - region.radius_m) < 1e-9) continue;  // on the border either answer is right
      EXPECT_EQ(visited.count(i), gap < region.radius_m ? 1u : 0u);
    }
  }
}

TEST(Regions, region_beyond_the_window_is_cut_off) {
  GridFrame grid;
  grid.width = grid.height = 10;
  grid.resolution_m = 0.2;
  Region region;
  region.parts = {makeSquare({100.0, 100.0}, 1.0), makeSquare({1.0, 1.0}, 100.0)};
  std::set<size_t> visited;
  forEachCell(region, grid, [&](size_t i) { visited.insert(i); });
  EXPECT_EQ(visited.size(), 100u);
  EXPECT_EQ(*visited.rbegin(), 99u);
}

TEST(Regions, region_wider_than_an_integer_can_say_covers_the_whole_window) {
  GridFrame grid;
  grid.origin = {-5, 7};
  grid.width = grid.height = 10;
  grid.resolution_m = 0.2;
  for (const double radius_m : {1e3, 1e9, 1e38}) {
    Region region;
    region.parts = {makeSquare({1.0, 1.0}, 0.3)};
    region.radius_m = radius_m;
    std::set<size_t> visited;
    forEachCell(region, grid, [&](size_t i) { visited.insert(i); });
    EXPECT_EQ(visited.size(), 100u) << radius_m;
  }
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
