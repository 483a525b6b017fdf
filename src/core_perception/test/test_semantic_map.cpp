// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <ctime>

#include "core_perception/exceptions.h"
#include "core_perception/semantic_map.h"
#include "scene.h"

namespace core_perception {
namespace {

constexpr double kPeriod_s = 0.1;

size_t indexAt(const SafetyGrid& grid, double x_m, double y_m) {
  const int x = static_cast<int>(std::floor(x_m / grid.frame.resolution_m)) - grid.frame.origin.x;
  const int y = static_cast<int>(std::floor(y_m / grid.frame.resolution_m)) - grid.frame.origin.y;
  EXPECT_TRUE(x >= 0 && y >= 0 && x < grid.frame.width && y < grid.frame.height);
  return static_cast<size_t>(y) * grid.frame.width + x;
}

CellState stateAt(const SafetyGrid& grid, double x_m, double y_m) {
  return grid.state[indexAt(grid, x_m, y_m)];
}

std::string ruleAt(const SafetyGrid& grid, double x_m, double y_m) {
  const uint16_t cause = grid.cause[indexAt(grid, x_m, y_m)];
  return cause == kNoCause ? "" : grid.causes[cause].rule;
}

std::vector<uint32_t> idsOf(const SemanticMap& map) {
  std::vector<uint32_t> ids;
  for (const HeldInstance& held : map.instances()) ids.push_back(held.id);
  return ids;
}

/// The same constraints with everything held now exempt from all predicates.
Constraints exemptAll(Constraints constraints, const SemanticMap& map) {
  constraints.instances_history_start_s = map.history_start_s();
  for (Predicate& predicate : constraints.predicates) {
    for (const uint32_t id : idsOf(map)) predicate.exempt_instances.insert(id);
  }
  return constraints;
}

TEST(SemanticMap, floor_is_safe_and_the_line_between_cones_is_not) {
  SemanticMap map{SemanticMapParams()};
  const Scene scene = makeConeLine();
  for (int k = 1; k <= 3; ++k)
    map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  const SafetyGrid& grid = map.grid();
  ASSERT_EQ(map.instances().size(), 5u);
  EXPECT_EQ(stateAt(grid, 3.0, 0.0), CellState::kSafe);
  EXPECT_EQ(stateAt(grid, 3.0, 1.5), CellState::kSafe);
  for (double y = -2.0; y <= 2.0; y += 0.1) {
    EXPECT_EQ(stateAt(grid, 4.9, y), CellState::kUnsafe) << y;
    EXPECT_EQ(ruleAt(grid, 4.9, y), "BETWEEN(traffic_cone)") << y;
  }
  EXPECT_EQ(stateAt(grid, 0.0, 0.0), CellState::kSafe) << "initial disc";
  EXPECT_EQ(stateAt(grid, 0.0, 3.0), CellState::kUnknown);
  EXPECT_EQ(ruleAt(grid, 0.0, 3.0), kUnknownRule);
  EXPECT_LT(grid.h_m[indexAt(grid, 0.0, 3.0)], 0.0f);
}

TEST(SemanticMap,
     line_holds_while_the_cones_are_out_of_view_and_the_floor_between_them_is_in_view) {
  SemanticMap map{SemanticMapParams()};
  Scene two;
  two.cylinders = {{"traffic_cone", {5.0, -1.3}}, {"traffic_cone", {5.0, 1.3}}};
  double stamp_s = 0.0;
  for (int k = 0; k < 5; ++k)
    map.update(two.render(stamp_s += kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  ASSERT_EQ(stateAt(map.grid(), 4.9, 0.0), CellState::kUnsafe);
  // At x = 3.5 m the camera looks between the cones: both lie outside its image, the floor between
  // them inside.
  for (int k = 0; k < 50; ++k)
    map.update(two.render(stamp_s += kPeriod_s, 3.5, 0.0, 0.0), makeConeRules());
  ASSERT_EQ(map.instances().size(), 2u);
  EXPECT_FALSE(map.instances()[0].in_view || map.instances()[1].in_view);
  const SafetyGrid& grid = map.grid();
  EXPECT_GT(grid.n_safe[indexAt(grid, 4.9, 0.0)], 0u) << "the floor there was voted safe meanwhile";
  for (double y = -1.3; y <= 1.3; y += 0.1)
    EXPECT_EQ(stateAt(grid, 4.9, y), CellState::kUnsafe) << y;
}

TEST(SemanticMap, votes_alone_lose_the_line_in_profile_paper) {
  SemanticMap map{makePaperParams()};
  const Scene scene = makeConeLine();
  double stamp_s = 0.0;
  for (int k = 0; k < 5; ++k)
    map.update(scene.render(stamp_s += kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  const SafetyGrid& grid = map.grid();
  EXPECT_EQ(stateAt(grid, 4.9, 0.0), CellState::kUnsafe);
  EXPECT_EQ(stateAt(grid, 3.9, 0.0), CellState::kSafe);
  EXPECT_EQ(stateAt(grid, -5.0, 0.0), CellState::kUnknown);
  EXPECT_GT(grid.h_m[indexAt(grid, -5.0, 0.0)], 0.0f) << "unknown is safe there";
}

TEST(SemanticMap, removed_cones_are_forgotten_once_their_places_are_seen_empty) {
  SemanticMap map{SemanticMapParams()};
  double stamp_s = 0.0;
  for (int k = 0; k < 20; ++k)
    map.update(makeConeLine().render(stamp_s += kPeriod_s, 0, 0, 0), makeConeRules());
  ASSERT_EQ(map.instances().size(), 5u);
  Scene empty = makeConeLine();
  for (Cylinder& cone : empty.cylinders) cone.centre.x = 50.0;  // still asked for, no longer there
  int frames = 0;
  while (!map.instances().empty() && frames < 50) {
    map.update(empty.render(stamp_s += kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
    ++frames;
  }
  EXPECT_EQ(frames, SemanticMapParams().instance.release_frames);
  for (int k = 0; k < 15; ++k)
    map.update(empty.render(stamp_s += kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  for (double y = -2.0; y <= 2.0; y += 0.1)
    EXPECT_EQ(stateAt(map.grid(), 4.9, y), CellState::kSafe) << y;
}

TEST(SemanticMap, obstacle_is_unsafe_whatever_the_predicates_say) {
  SemanticMap map{SemanticMapParams()};
  Scene scene;
  scene.cylinders = {{"statue", {3.0, 0.0}}};
  Constraints captured;
  captured.image_stamp_s = 0.5;
  captured.predicates = {makePredicate(SpatialOperator::kOn, "floor", Verdict::kSafe),
                         makePredicate(SpatialOperator::kNear, "statue", Verdict::kSafe),
                         makePredicate(SpatialOperator::kOn, "statue", Verdict::kSafe)};
  map.update(scene.render(1.0, 0.0, 0.0, 0.0), captured);
  EXPECT_EQ(stateAt(map.grid(), 2.9, 0.0), CellState::kUnsafe);
  EXPECT_EQ(ruleAt(map.grid(), 2.9, 0.0), kMetricRule);
}

TEST(SemanticMap, without_semantics_only_what_stands_up_is_unsafe) {
  SemanticMapParams params;
  params.semantics = params.unknown_is_unsafe = false;
  Constraints rules = makeConeRules();
  rules.predicates[0].verdict = Verdict::kUnsafe;  // ON(floor)
  const Scene scene = makeConeLine();
  for (const Constraints& stated : {rules, Constraints()}) {
    SemanticMap map{params};
    for (int k = 1; k <= 3; ++k) map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), stated);
    const SafetyGrid& grid = map.grid();
    for (const Cylinder& cone : scene.cylinders) {
      const double front_m = cone.centre.x - cone.radius_m + 0.01;
      EXPECT_EQ(stateAt(grid, front_m, cone.centre.y), CellState::kUnsafe) << cone.centre.y;
      EXPECT_EQ(ruleAt(grid, front_m, cone.centre.y), kMetricRule);
    }
    const double gap_m = 0.5 * (scene.cylinders[1].centre.y + scene.cylinders[2].centre.y);
    for (double x = 2.5; x <= 6.0; x += 0.1)
      EXPECT_EQ(stateAt(grid, x, gap_m), CellState::kSafe) << x;
    EXPECT_EQ(stateAt(grid, 0.0, 3.0), CellState::kUnknown);
    EXPECT_GT(grid.h_m[indexAt(grid, 0.0, 3.0)], 0.0f) << "unknown is safe";
    EXPECT_TRUE(map.predicates().empty());
  }
}

TEST(SemanticMap, without_semantics_the_operators_on_pixels_decide_nothing_either) {
  SemanticMapParams params = makePaperParams();
  params.semantics = false;
  params.vote.metric_layer = true;
  SemanticMap map{params};
  for (int k = 1; k <= 3; ++k)
    map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  EXPECT_EQ(stateAt(map.grid(), 4.5, 0.7), CellState::kSafe);
}

TEST(SemanticMap, unsafe_surface_is_unsafe_although_another_predicate_calls_it_safe) {
  SemanticMap map{SemanticMapParams()};
  Constraints rules = makeConeRules();
  rules.predicates.push_back(makePredicate(SpatialOperator::kOn, "floor", Verdict::kUnsafe));
  map.update(Scene().render(0.1, 0.0, 0.0, 0.0), rules);
  EXPECT_EQ(stateAt(map.grid(), 3.0, 0.0), CellState::kUnsafe);
  EXPECT_EQ(ruleAt(map.grid(), 3.0, 0.0), "ON(floor)");
}

TEST(SemanticMap, predicate_on_an_object_does_not_undo_the_regions_it_makes) {
  for (const Verdict verdict : {Verdict::kSafe, Verdict::kUnsafe}) {
    SemanticMap map{SemanticMapParams()};
    Constraints rules = makeConeRules();
    int k = 0;
    while (++k <= 3) map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
    ASSERT_EQ(ruleAt(map.grid(), 4.9, 0.5), "BETWEEN(traffic_cone)");
    rules.predicates.push_back(makePredicate(SpatialOperator::kOn, "traffic_cone", verdict));
    while (++k <= 9) map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
    EXPECT_EQ(map.instances().size(), 5u);
    EXPECT_EQ(stateAt(map.grid(), 4.9, 0.5), CellState::kUnsafe);
    EXPECT_EQ(ruleAt(map.grid(), 4.9, 0.5), "BETWEEN(traffic_cone)");
  }
}

TEST(SemanticMap, objects_of_a_class_that_only_on_speaks_of_are_hidden_while_it_does) {
  SemanticMap map{SemanticMapParams()};
  Constraints surface = makeConeRules();
  surface.predicates = {makePredicate(SpatialOperator::kOn, "floor", Verdict::kSafe),
                        makePredicate(SpatialOperator::kOn, "traffic_cone", Verdict::kUnsafe)};
  int k = 0;
  while (++k <= 3) map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  const std::vector<uint32_t> before = idsOf(map);
  ASSERT_EQ(before.size(), 5u);
  ASSERT_EQ(ruleAt(map.grid(), 4.9, 0.5), "BETWEEN(traffic_cone)");
  while (++k <= 15) {
    map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), surface);
    EXPECT_TRUE(map.instances().empty());
  }
  EXPECT_EQ(stateAt(map.grid(), 4.9, 0.5), CellState::kSafe) << "no region, and the floor is voted";
  EXPECT_EQ(stateAt(map.grid(), 4.9, 0.0), CellState::kUnsafe) << "the cone itself stands there";
  // Back at once, although the robot looks the other way by now.
  map.update(makeConeLine().render(++k * kPeriod_s, 0.0, 0.0, 3.14), makeConeRules());
  EXPECT_EQ(idsOf(map), before);
  for (double y = -2.0; y <= 2.0; y += 0.1)
    EXPECT_EQ(ruleAt(map.grid(), 4.9, y), "BETWEEN(traffic_cone)") << y;
}

TEST(SemanticMap, flat_thing_is_unsafe_by_near_although_on_it_is_called_safe) {
  Scene scene;
  scene.cylinders = {{"puddle", {3.0, 0.0}, 0.4, 0.0, 0.01}};
  const Predicate on = makePredicate(SpatialOperator::kOn, "puddle", Verdict::kSafe);
  const Predicate near = makePredicate(SpatialOperator::kNear, "puddle", Verdict::kUnsafe);
  const auto decide = [&scene](const std::vector<Predicate>& predicates, int frames) {
    SemanticMap map{SemanticMapParams()};
    Constraints rules = makeConeRules();
    rules.predicates.insert(rules.predicates.end(), predicates.begin(), predicates.end());
    for (int k = 1; k <= frames; ++k) map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
    const size_t n_held = map.instances().size();
    return std::make_tuple(stateAt(map.grid(), 2.9, 0.1), ruleAt(map.grid(), 2.9, 0.1), n_held);
  };
  ASSERT_EQ(decide({on}, 1), std::make_tuple(CellState::kSafe, std::string(), size_t{0}));
  const auto expected = std::make_tuple(CellState::kUnsafe, std::string("NEAR(puddle)"), size_t{1});
  for (const int frames : {1, 3}) {
    EXPECT_EQ(decide({on, near}, frames), expected) << frames;
    EXPECT_EQ(decide({near, on}, frames), expected) << frames;
  }
}

TEST(SemanticMap, exempt_objects_have_no_regions_any_more) {
  SemanticMap map{SemanticMapParams()};
  Constraints rules = makeConeRules();
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kAround, "traffic_cone", Verdict::kUnsafe, 0.7));
  int k = 0;
  while (++k <= 3) map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
  ASSERT_EQ(stateAt(map.grid(), 4.5, 2.1), CellState::kUnsafe);
  Constraints exempting = exemptAll(rules, map);
  const uint32_t last = *exempting.predicates.back().exempt_instances.rbegin();
  for (Predicate& predicate : exempting.predicates) predicate.exempt_instances.erase(last);
  map.update(makeConeLine().render(++k * kPeriod_s, 0.0, 0.0, 0.0), exempting);
  int n_around = 0;
  for (const HeldInstance& held : map.instances()) {
    const Point2 centre = computeCentre(held.footprint);
    const bool around = stateAt(map.grid(), 4.3, centre.y) == CellState::kUnsafe;
    EXPECT_EQ(around, held.id == last) << held.id;
    n_around += around ? 1 : 0;
  }
  EXPECT_EQ(n_around, 1);
  EXPECT_EQ(ruleAt(map.grid(), 4.9, 0.5), "BETWEEN(traffic_cone)") << "one member is not exempt";
  exempting = exemptAll(rules, map);
  map.update(makeConeLine().render(++k * kPeriod_s, 0.0, 0.0, 0.0), exempting);
  EXPECT_EQ(stateAt(map.grid(), 4.9, 0.5), CellState::kSafe);
  EXPECT_EQ(ruleAt(map.grid(), 4.9, 0.0), kMetricRule) << "an obstacle it remains";
  EXPECT_EQ(map.predicates().back().exempt_instances, exempting.predicates.back().exempt_instances);
  map.update(makeConeLine().render(++k * kPeriod_s, 0.0, 0.0, 0.0), rules);
  EXPECT_EQ(ruleAt(map.grid(), 4.5, 2.1), "AROUND(traffic_cone)") << "back with the next answer";
}

TEST(SemanticMap, exemptions_that_count_by_another_history_are_ignored) {
  SemanticMap map{SemanticMapParams()};
  EXPECT_EQ(map.history_start_s(), 0.0);
  int k = 0;
  while (++k <= 3) map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  EXPECT_DOUBLE_EQ(map.history_start_s(), kPeriod_s);
  for (const double start_s : {0.0, 0.05, 0.2, std::numeric_limits<double>::quiet_NaN()}) {
    Constraints exempting = exemptAll(makeConeRules(), map);
    exempting.instances_history_start_s = start_s;
    map.update(makeConeLine().render(++k * kPeriod_s, 0.0, 0.0, 0.0), exempting);
    EXPECT_EQ(ruleAt(map.grid(), 4.9, 0.5), "BETWEEN(traffic_cone)") << start_s;
    for (const Predicate& predicate : map.predicates())
      EXPECT_TRUE(predicate.exempt_instances.empty());
  }
}

TEST(SemanticMap, exemptions_do_not_outlive_a_clear_even_when_the_stamps_repeat) {
  SemanticMap map{SemanticMapParams()};
  for (int k = 1; k <= 3; ++k)
    map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  const Constraints exempting = exemptAll(makeConeRules(), map);
  map.update(makeConeLine().render(4 * kPeriod_s, 0.0, 0.0, 0.0), exempting);
  ASSERT_EQ(stateAt(map.grid(), 4.9, 0.5), CellState::kSafe);
  map.clear();
  EXPECT_EQ(map.history_start_s(), 0.0);
  EXPECT_TRUE(map.predicates().empty());
  for (int k = 1; k <= 4; ++k)  // a simulation that was reset starts with the same stamps
    map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), exempting);
  ASSERT_EQ(map.history_start_s(), exempting.instances_history_start_s);
  EXPECT_EQ(ruleAt(map.grid(), 4.9, 0.5), "BETWEEN(traffic_cone)");
}

TEST(SemanticMap, two_exempt_objects_that_turn_out_to_be_one_are_exempt_no_longer) {
  SemanticMap map{SemanticMapParams()};
  Constraints rules = makeConeRules();
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kAround, "traffic_cone", Verdict::kUnsafe, 1.0));
  Scene two, one;
  two.cylinders = {{"traffic_cone", {3.0, -0.2}, 0.08}, {"traffic_cone", {3.0, 0.2}, 0.08}};
  one.cylinders = {{"traffic_cone", {3.0, 0.0}, 0.35}};
  int k = 0;
  while (++k <= 3) map.update(two.render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
  ASSERT_EQ(map.instances().size(), 2u);
  const Constraints exempting = exemptAll(rules, map);
  map.update(two.render(++k * kPeriod_s, 0.0, 0.0, 0.0), exempting);
  ASSERT_EQ(stateAt(map.grid(), 2.1, 0.0), CellState::kSafe);
  map.update(one.render(++k * kPeriod_s, 0.0, 0.0, 0.0), exempting);
  ASSERT_EQ(map.instances().size(), 1u);
  EXPECT_EQ(ruleAt(map.grid(), 2.1, 0.0), "AROUND(traffic_cone)");
}

TEST(SemanticMap, operators_on_pixels_heed_no_exemption) {
  SemanticMap map{makePaperParams()}, plain{makePaperParams()};
  for (int k = 1; k <= 5; ++k) {
    const Frame frame = makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0);
    map.update(frame, exemptAll(makeConeRules(), map));
    plain.update(frame, makeConeRules());
  }
  ASSERT_EQ(idsOf(map).size(), 5u);
  EXPECT_EQ(map.grid().state, plain.grid().state);
  for (const Predicate& predicate : map.predicates())
    EXPECT_TRUE(predicate.exempt_instances.empty());
}

TEST(SemanticMap, nothing_is_in_force_before_the_first_answer_whatever_the_message_lists) {
  SemanticMap map{SemanticMapParams()};
  Constraints rules = makeConeRules();
  map.update(makeConeLine().render(0.1, 0.0, 0.0, 0.0), rules);
  EXPECT_EQ(map.predicates().size(), rules.predicates.size());
  rules.image_stamp_s = 0.0;
  map.update(makeConeLine().render(0.2, 0.0, 0.0, 0.0), rules);
  EXPECT_TRUE(map.predicates().empty());
}

TEST(SemanticMap, distance_follows_every_change_of_the_decision) {
  SemanticMap map{SemanticMapParams()};
  const Scene scene = makeConeLine();
  for (int k = 1; k <= 8; ++k) {
    // The robot turns, walks, stands still: cells change with and without a move of the window.
    const Constraints rules = k == 1 ? Constraints() : makeConeRules();
    const SafetyGrid& grid =
        map.update(scene.render(k * kPeriod_s, 0.15 * (k / 2), 0.0, 0.1 * (k / 3)), rules);
    Mask mask;
    mask.width = grid.frame.width;
    mask.height = grid.frame.height;
    for (const CellState state : grid.state)
      mask.unsafe.push_back(state == CellState::kSafe ? 0 : 1);
    EXPECT_EQ(grid.h_m, computeSignedDistance(mask, 0.2, DistanceConvention::kBorder)) << k;
  }
}

TEST(SemanticMap, what_hangs_above_the_robot_does_not_mark_the_floor) {
  SemanticMap map{SemanticMapParams()};
  Scene scene;
  scene.cylinders = {{"lamp", {5.0, 0.0}, 0.3, 1.2, 1.5}};
  Constraints rules = makeConeRules();
  for (int k = 1; k <= 5; ++k) map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
  EXPECT_EQ(stateAt(map.grid(), 5.1, 0.0), CellState::kSafe);
}

TEST(SemanticMap, nothing_is_voted_before_the_first_answer_but_objects_are_tracked) {
  SemanticMap map{SemanticMapParams()};
  for (int k = 1; k <= 3; ++k)
    map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), Constraints());
  EXPECT_EQ(map.instances().size(), 5u);
  EXPECT_EQ(map.votes().tree().size(), 0u);
  EXPECT_EQ(stateAt(map.grid(), 3.0, 0.0), CellState::kUnknown);
  EXPECT_EQ(stateAt(map.grid(), 1.0, 0.0), CellState::kSafe);
}

TEST(SemanticMap, safe_between_cancels_the_unsafe_one_and_makes_no_ground_safe) {
  SemanticMap map{SemanticMapParams()};
  Constraints rules = makeConeRules();
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kBetween, "traffic_cone", Verdict::kSafe));
  rules.predicates.erase(rules.predicates.begin());  // nor is the floor safe
  for (int k = 1; k <= 3; ++k)
    map.update(makeConeLine().render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
  EXPECT_EQ(stateAt(map.grid(), 4.9, 0.5), CellState::kUnsafe);
  EXPECT_EQ(ruleAt(map.grid(), 4.9, 0.5), kNotSafeRule);
}

TEST(SemanticMap, slow_predicate_caps_the_speed_instead_of_closing_the_way) {
  SemanticMap map{SemanticMapParams()};
  Scene scene;
  scene.cylinders = {{"person", {4.0, 0.0}}};
  Constraints rules = makeConeRules();
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kAround, "person", Verdict::kUnsafe, 1.0));
  rules.predicates.back().severity = Severity::kSlow;
  for (int k = 1; k <= 3; ++k) map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
  const SafetyGrid& grid = map.grid();
  ASSERT_EQ(grid.speed_cap_mps.size(), grid.state.size());
  EXPECT_EQ(stateAt(grid, 3.3, 0.0), CellState::kSafe);
  EXPECT_FLOAT_EQ(grid.speed_cap_mps[indexAt(grid, 3.3, 0.0)], 0.2f);
  EXPECT_TRUE(std::isnan(grid.speed_cap_mps[indexAt(grid, 2.3, 0.0)]));
}

TEST(SemanticMap, slow_region_within_a_barrier_and_around_it_caps_the_speed_whatever_comes_first) {
  Scene scene;
  scene.cylinders = {{"person", {4.0, 0.0}}, {"traffic_cone", {4.0, 0.6}}};
  Predicate slow = makePredicate(SpatialOperator::kAround, "person", Verdict::kUnsafe, 1.5);
  slow.severity = Severity::kSlow;
  const Predicate stop =
      makePredicate(SpatialOperator::kAround, "traffic_cone", Verdict::kUnsafe, 0.5);
  for (const bool slow_first : {true, false}) {
    SemanticMap map{SemanticMapParams()};
    Constraints rules = makeConeRules();
    rules.predicates.push_back(slow_first ? slow : stop);
    rules.predicates.push_back(slow_first ? stop : slow);
    for (int k = 1; k <= 3; ++k) map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
    const SafetyGrid& grid = map.grid();
    ASSERT_EQ(grid.speed_cap_mps.size(), grid.state.size());
    EXPECT_EQ(stateAt(grid, 3.5, 0.7), CellState::kUnsafe);
    EXPECT_EQ(ruleAt(grid, 3.5, 0.7), "AROUND(traffic_cone)");
    EXPECT_LT(grid.h_m[indexAt(grid, 3.5, 0.7)], 0.0f);
    EXPECT_FLOAT_EQ(grid.speed_cap_mps[indexAt(grid, 3.5, 0.7)], 0.2f);
    EXPECT_EQ(stateAt(grid, 3.1, -0.3), CellState::kSafe);
    EXPECT_EQ(ruleAt(grid, 3.1, -0.3), "AROUND(person)");
    EXPECT_FLOAT_EQ(grid.speed_cap_mps[indexAt(grid, 3.1, -0.3)], 0.2f);
    EXPECT_EQ(stateAt(grid, 3.9, 0.1), CellState::kUnsafe) << "the person stands there";
    EXPECT_TRUE(std::isnan(grid.speed_cap_mps[indexAt(grid, 2.1, 0.1)]));
  }
}

TEST(SemanticMap, cause_tells_whether_what_is_behind_it_moves) {
  Scene scene = makeConeLine();
  scene.cylinders.push_back({"person", {3.0, 0.0}});
  scene.cylinders.push_back({"statue", {3.0, 1.2}});
  Constraints rules = makeConeRules();
  for (const char* name : {"person", "statue"})
    rules.predicates.push_back(
        makePredicate(SpatialOperator::kAround, name, Verdict::kUnsafe, 0.5));
  SemanticMap map{SemanticMapParams()};
  map.update(scene.render(0.1, 0.0, 0.0, 0.0), rules);  // votes alone
  std::map<std::string, bool> mobile;
  const auto note = [&] {
    const SafetyGrid& grid = map.grid();
    for (const uint16_t cause : grid.cause) {
      if (cause == kNoCause) continue;
      const Cause& c = grid.causes[cause];
      mobile[c.rule + " " + c.class_name] = c.mobile;
    }
  };
  note();
  Frame unlabelled = scene.render(0.2, 0.0, 0.0, 0.0);
  unlabelled.labels.setTo(0, unlabelled.labels == 8);  // the statue
  map.update(unlabelled, rules);
  note();
  map.update(scene.render(0.3, 0.0, 0.0, 0.0), rules);
  note();
  const std::map<std::string, bool> expected{{"METRIC person", true},
                                             {"METRIC statue", false},
                                             {"METRIC ", false},
                                             {"METRIC traffic_cone", false},
                                             {"AROUND(person) person", true},
                                             {"AROUND(statue) statue", false},
                                             {"UNKNOWN ", false},
                                             {"BETWEEN(traffic_cone) traffic_cone", false}};
  for (const auto& entry : expected) {
    ASSERT_EQ(mobile.count(entry.first), 1u) << entry.first;
    EXPECT_EQ(mobile[entry.first], entry.second) << entry.first;
  }
}

TEST(SemanticMap, a_region_outside_the_window_leaves_no_cause_in_the_grid) {
  Scene scene;
  scene.cylinders = {{"person", {5.0, 0.0}}};
  Constraints rules = makeConeRules();
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kAround, "person", Verdict::kUnsafe, 1.0));
  for (const double size_m : {12.0, 4.0}) {
    SemanticMapParams params;
    params.window_m = size_m;
    SemanticMap map{params};
    for (int k = 1; k <= 3; ++k) map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), rules);
    const std::vector<Cause>& causes = map.grid().causes;
    const auto around = std::count_if(causes.begin(), causes.end(), [](const Cause& cause) {
      return cause.rule == "AROUND(person)";
    });
    EXPECT_EQ(around, size_m > 10.0 ? 1 : 0);
  }
}

TEST(SemanticMap, person_out_of_view_fades_to_unknown_and_a_cone_stays) {
  Scene scene;
  scene.cylinders = {{"person", {3.0, 0.0}, 0.2, 0.0, 1.7}, {"traffic_cone", {3.0, 1.0}}};
  Constraints rules = makeConeRules();
  SemanticMap map{SemanticMapParams()};
  double stamp_s = 1.0;
  for (int k = 0; k < 20; ++k) map.update(Scene().render(stamp_s += 0.1, 0.0, 0.0, 0.0), rules);
  for (int k = 0; k < 20; ++k) map.update(scene.render(stamp_s += 0.1, 0.0, 0.0, 0.0), rules);
  ASSERT_EQ(stateAt(map.grid(), 2.9, 0.1), CellState::kUnsafe);
  ASSERT_EQ(stateAt(map.grid(), 2.9, 0.9), CellState::kUnsafe);
  for (int k = 0; k < 100; ++k) map.update(Scene().render(stamp_s += 0.1, 0.0, 0.0, 3.14), rules);
  EXPECT_EQ(stateAt(map.grid(), 2.9, 0.1), CellState::kUnknown) << "not safe by floor seen before";
  EXPECT_EQ(stateAt(map.grid(), 2.9, 0.9), CellState::kUnsafe);
  EXPECT_EQ(map.instances().size(), 2u) << "held longer than its votes";
  map.update(Scene().render(stamp_s += 20.0, 0.0, 0.0, 3.14), rules);
  ASSERT_EQ(map.instances().size(), 1u);
  EXPECT_EQ(map.instances()[0].class_name, "traffic_cone");
}

TEST(SemanticMap, table_top_above_the_image_stays_although_the_floor_below_it_is_seen) {
  Scene scene;
  scene.cylinders = {{"table", {1.6, 0.1}, 0.15, 0.85, 0.89}};
  SemanticMap map{SemanticMapParams()};
  double stamp_s = 1.0;
  for (int k = 0; k < 10; ++k)
    map.update(scene.render(stamp_s += 0.1, -2.0, 0.0, 0.0), makeConeRules());
  ASSERT_EQ(ruleAt(map.grid(), 1.5, 0.1), kMetricRule);
  const Frame near = scene.render(stamp_s + 0.1, 0.0, 0.0, 0.0);
  ASSERT_EQ(cv::countNonZero(near.labels == 2), 0) << "the camera looks below it";
  for (int k = 0; k < 100; ++k)
    map.update(scene.render(stamp_s += 0.1, 0.0, 0.0, 0.0), makeConeRules());
  EXPECT_EQ(stateAt(map.grid(), 1.5, 0.1), CellState::kUnsafe);
}

TEST(SemanticMap, where_unknown_is_safe_nobody_fades) {
  Scene scene;
  scene.cylinders = {{"person", {3.0, 0.0}, 0.2, 0.0, 1.7}};
  SemanticMapParams params;
  params.semantics = params.unknown_is_unsafe = false;
  SemanticMap map{params};
  map.update(scene.render(1.0, 0.0, 0.0, 0.0), Constraints());
  map.update(Scene().render(1e6, 0.0, 0.0, 3.14), Constraints());
  EXPECT_EQ(stateAt(map.grid(), 2.9, 0.1), CellState::kUnsafe);
}

TEST(SemanticMap, of_too_many_objects_those_that_something_unsafe_is_said_of_are_kept) {
  SemanticMapParams params;
  params.instance.max_instances = 5;
  SemanticMap map{params};
  Scene scene = makeConeLine();
  for (int i = -2; i <= 2; ++i)
    scene.cylinders.push_back({"statue", {3.0, 0.45 * i}, 0.1, 0.0, 0.2});
  for (int k = 1; k <= 3; ++k)
    map.update(scene.render(k * kPeriod_s, 0.0, 0.0, 0.0), makeConeRules());
  ASSERT_EQ(map.instances().size(), 5u);
  for (const HeldInstance& held : map.instances()) EXPECT_EQ(held.class_name, "traffic_cone");
  EXPECT_EQ(map.countDroppedInstances(), 15u);
}

TEST(SemanticMap, ten_thousand_false_detections_neither_fill_the_memory_nor_take_seconds) {
  SemanticMapParams params;
  SemanticMap map{params};
  Constraints rules = makeConeRules();
  rules.predicates.push_back(makePredicate(SpatialOperator::kAround, "ghost", Verdict::kUnsafe));
  Frame frame = Scene().render(1.0, 0.0, 0.0, 0.0);
  frame.classes.clear();
  for (int id = 1; id <= 10000; ++id) frame.classes.push_back({static_cast<uint16_t>(id), "ghost"});
  double slowest_s = 0.0;
  for (int k = 0; k < 6; ++k) {
    for (int v = 0; v < frame.labels.rows; ++v) {
      for (int u = 0; u < frame.labels.cols; ++u)  // patches of 4 x 4 pixels, elsewhere every time
        frame.labels.at<uint16_t>(v, u) =
            static_cast<uint16_t>(1 + ((u + 2 * k) / 4 + 125 * ((v + k) / 4)) % 10000);
    }
    frame.stamp_s += 0.1;
    const std::clock_t start = std::clock();
    map.update(frame, rules);
    slowest_s = std::max(slowest_s, 1.0 * (std::clock() - start) / CLOCKS_PER_SEC);
    EXPECT_LE(map.instances().size(), static_cast<size_t>(params.instance.max_instances));
  }
  EXPECT_GT(map.countDroppedInstances(), 10000u);
  EXPECT_LT(slowest_s, 1.0);
}

TEST(SemanticMap, refused_frame_changes_nothing) {
  SemanticMap map{SemanticMapParams()};
  const Scene scene = makeConeLine();
  map.update(scene.render(0.1, 0.0, 0.0, 0.0), makeConeRules());
  const SafetyGrid before = map.grid();
  const size_t nodes = map.votes().tree().size();
  const Constraints others = exemptAll(Constraints(), map);
  std::vector<Frame> bad(11, scene.render(0.2, 1.0, 0.0, 0.0));
  bad[0].labels = bad[0].labels.rowRange(0, 100).clone();
  bad[1].depth.convertTo(bad[1].depth, CV_64F);
  bad[2].camera.fx_px = 0.0;
  bad[3].stamp_s = 0.0;
  bad[4].T_map_camera.translation().x() = std::numeric_limits<double>::quiet_NaN();
  bad[5].depth = cv::Mat();
  bad[6].camera.fx_px = 1.0;
  bad[7].camera.cx_px = 1e9;
  bad[8].p_map_base.y = 1e300;
  bad[9].T_map_camera.linear() *= 2.0;
  bad[10].classes.push_back({bad[10].classes.back().id, "floor"});
  for (const Frame& frame : bad) EXPECT_THROW(map.update(frame, others), FrameError);
  EXPECT_EQ(map.predicates().size(), makeConeRules().predicates.size());
  EXPECT_EQ(map.votes().tree().size(), nodes);
  EXPECT_EQ(map.grid().state, before.state);
  EXPECT_EQ(map.grid().frame.origin.x, before.frame.origin.x);
}

TEST(SemanticMap, frame_beyond_what_the_tree_can_hold_is_refused) {
  SemanticMapParams params;
  params.resolution_m = 0.05;  // 2^15 voxels to each side: 1638.4 m
  params.window_m = 10.0;
  SemanticMap map{params};
  EXPECT_NO_THROW(map.update(Scene().render(0.1, -1620.0, 0.0, 0.0), makeConeRules()));
  EXPECT_EQ(stateAt(map.grid(), -1617.0, 0.0), CellState::kSafe);
  EXPECT_THROW(map.update(Scene().render(0.2, -1637.0, 0.0, 0.0), makeConeRules()), FrameError);
}

TEST(SemanticMap, millimetres_and_metres_give_the_same_decision) {
  SemanticMap metres{SemanticMapParams()}, millimetres{SemanticMapParams()};
  Frame frame = makeConeLine().render(0.1, 0.0, 0.0, 0.0);
  frame.depth.setTo(0.0f, frame.depth != frame.depth);
  cv::Mat mm;
  frame.depth.convertTo(mm, CV_16UC1, 1000.0);
  mm.convertTo(frame.depth, CV_32FC1, 0.001);
  metres.update(frame, makeConeRules());
  frame.depth = mm;
  millimetres.update(frame, makeConeRules());
  EXPECT_EQ(metres.grid().state, millimetres.grid().state);
}

TEST(SemanticMap, paper_counts_every_pixel_in_range_once) {
  SemanticMap map{makePaperParams()};
  const Frame frame = makeConeLine().render(0.1, 0.0, 0.0, 0.0);
  map.update(frame, makeConeRules());
  uint64_t expected = 0, counted = 0;
  for (int v = 0; v < frame.depth.rows; ++v) {
    for (int u = 0; u < frame.depth.cols; ++u) {
      const float z = frame.depth.at<float>(v, u);
      expected += z >= 3.0f && z <= 7.0f ? 1 : 0;
    }
  }
  SemanticOcTree& tree = map.votes().tree();
  for (auto it = tree.begin_leafs(); it != tree.end_leafs(); ++it)
    counted += it->n_safe() + it->n_unsafe();
  EXPECT_GT(expected, 10000u);
  EXPECT_EQ(counted, expected);
}

TEST(SemanticMap, clear_forgets_everything) {
  SemanticMap map{SemanticMapParams()};
  map.update(makeConeLine().render(0.1, 0.0, 0.0, 0.0), makeConeRules());
  map.clear();
  EXPECT_TRUE(map.instances().empty());
  map.update(makeConeLine().render(0.2, 0.0, 9.0, 3.14), Constraints());
  EXPECT_EQ(stateAt(map.grid(), 3.0, 0.0), CellState::kUnknown);
  EXPECT_EQ(stateAt(map.grid(), 0.0, 9.0), CellState::kSafe)
      << "the disc is where the robot starts anew";
}

TEST(SemanticMap, cleared_box_is_unknown_and_begins_a_new_history_without_a_new_disc) {
  SemanticMap map{SemanticMapParams()};
  const Scene scene = makeConeLine();
  for (int i = 1; i <= 4; ++i) map.update(scene.render(i, 0.0, 0.0, 0.0), makeConeRules());
  EXPECT_EQ(map.history_start_s(), 1.0);
  EXPECT_FALSE(map.clearBox({50.0, 50.0, -1.0}, {60.0, 60.0, 1.0}));
  EXPECT_EQ(map.history_start_s(), 1.0) << "nothing was there";
  EXPECT_TRUE(map.clearBox({4.0, -9.0, -1.0}, {6.0, 9.0, 3.0}));
  EXPECT_TRUE(map.instances().empty());
  EXPECT_EQ(map.history_start_s(), 0.0);
  Frame blind = scene.render(5.0, 3.0, 0.0, 0.0);
  blind.depth.setTo(0.0f);
  const SafetyGrid& grid = map.update(blind, makeConeRules());
  EXPECT_EQ(map.history_start_s(), 5.0);
  EXPECT_EQ(stateAt(grid, 5.1, 0.1), CellState::kUnknown);
  EXPECT_NE(stateAt(grid, 3.9, 0.1), CellState::kUnknown) << "outside the box all is kept";
}

TEST(SemanticMap, initial_disc_holds_only_where_nothing_was_ever_seen) {
  SemanticMapParams params;
  params.initial_disc_radius_m = 4.0;
  SemanticMap map{params};
  Frame blind = Scene().render(9.0, 0.0, 0.0, 0.0);
  blind.depth.setTo(0.0f);
  Scene scene;
  scene.cylinders = {{"statue", {3.0, 0.0}}};
  for (int i = 1; i <= 4; ++i) map.update(scene.render(i, 0.0, 0.0, 0.0), makeConeRules());
  ASSERT_EQ(stateAt(map.grid(), 2.9, 0.1), CellState::kUnsafe);
  ASSERT_EQ(stateAt(map.grid(), 2.5, 0.5), CellState::kSafe);
  ASSERT_TRUE(map.clearBox({2.0, -1.0, -1.0}, {3.6, 1.0, 3.0}));
  const SafetyGrid& grid = map.update(blind, makeConeRules());
  EXPECT_EQ(stateAt(grid, 2.9, 0.1), CellState::kUnknown) << "the statue may stand there still";
  EXPECT_EQ(stateAt(grid, 2.5, 0.5), CellState::kUnknown);
  EXPECT_EQ(stateAt(grid, 3.7, 0.5), CellState::kSafe) << "outside the box";
  EXPECT_EQ(stateAt(grid, -2.0, 0.1), CellState::kSafe) << "never seen";
  map.clear();
  map.update(blind, makeConeRules());
  EXPECT_EQ(stateAt(map.grid(), 2.9, 0.1), CellState::kSafe) << "as at first";
}

TEST(SemanticMap, box_without_end_clears_everything) {
  SemanticMap map{SemanticMapParams()};
  map.update(makeConeLine().render(1.0, 0.0, 0.0, 0.0), makeConeRules());
  const double inf = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(map.clearBox({-inf, -inf, -inf}, {inf, inf, inf}));
  EXPECT_EQ(map.votes().tree().getNumLeafNodes(), 0u);
}

TEST(SemanticMap, loaded_map_adds_barriers_and_no_safe_ground) {
  SemanticMap seen{SemanticMapParams()};
  for (int i = 1; i <= 4; ++i)
    seen.update(makeConeLine().render(i, 0.0, 0.0, 0.0), makeConeRules());
  SemanticMap map{SemanticMapParams()};
  map.load(seen.votes().tree());
  Frame blind = makeConeLine().render(1.0, 0.0, 0.0, 0.0);
  blind.depth.setTo(0.0f);
  const SafetyGrid& grid = map.update(blind, makeConeRules());
  int n_unsafe = 0;
  for (size_t i = 0; i < grid.state.size(); ++i) {
    if (grid.state[i] != CellState::kUnsafe) continue;
    ++n_unsafe;
    EXPECT_EQ(grid.causes.at(grid.cause[i]).rule, kSavedRule);
  }
  EXPECT_GT(n_unsafe, 4) << "the cones";
  EXPECT_EQ(stateAt(grid, 3.5, 0.1), CellState::kUnknown) << "what was safe then may not be now";
}

TEST(SemanticMap, camera_that_sees_too_many_voxels_is_refused) {
  SemanticMapParams params;
  params.resolution_m = 0.02;
  params.range.range_max_m = 50.0;
  SemanticMap map(params);
  EXPECT_THROW(map.update(makeConeLine().render(1.0, 0.0, 0.0, 0.0), makeConeRules()), FrameError);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
