// SPDX-License-Identifier: BSD-3-Clause
// People who stand, walk, cross and leave, on rendered frames with the noise of a depth camera.
#include <gtest/gtest.h>

#include <map>
#include <opencv2/imgproc.hpp>
#include <random>
#include <set>

#include "core_perception/semantic_map.h"
#include "scene.h"

namespace core_perception {
namespace {

constexpr double kRadius_m = 1.0;  // of AROUND(person)
constexpr double kMost_s = 3.0;    // that a place seen empty may stay unsafe

Constraints makePersonRules() {
  Constraints rules = makeConeRules();
  rules.predicates.push_back(makePredicate(SpatialOperator::kNear, "person", Verdict::kUnsafe));
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kAround, "person", Verdict::kUnsafe, kRadius_m));
  return rules;
}

Cylinder makePerson(double x_m, double y_m) { return {"person", {x_m, y_m}, 0.22, 0.0, 1.7}; }

/// How people are seen.
struct Sight {
  double rate_hz;
  int erode_px;  ///< by which the masks of people and cones are too small
};

/// Noise as of a D435: error of depth growing with its square, 1 % of the pixels without depth.
void spoilDepth(std::mt19937* random, Frame* frame) {
  constexpr double kNoise_perm = 0.0012;
  constexpr double kHoles = 0.01;
  std::normal_distribution<float> error;
  std::uniform_real_distribution<float> uniform;
  for (int v = 0; v < frame->depth.rows; ++v) {
    float* row = frame->depth.ptr<float>(v);
    for (int u = 0; u < frame->depth.cols; ++u) {
      if (uniform(*random) < kHoles) row[u] = 0.0f;
      row[u] += static_cast<float>(kNoise_perm) * row[u] * row[u] * error(*random);
    }
  }
}

void spoilLabels(int erode_px, Frame* frame) {
  const cv::Mat objects = frame->labels > 1;
  cv::Mat inner;
  cv::erode(objects, inner, cv::Mat::ones(2 * erode_px + 1, 2 * erode_px + 1, CV_8U));
  frame->labels.setTo(0, objects & ~inner);
}

/// A map at the rate of a camera, and the robot whose camera it is.
class Watch {
 public:
  explicit Watch(const Sight& sight) : sight_(sight), period_s_(1.0 / sight.rate_hz) {}

  const SafetyGrid& look(const Scene& scene, double yaw_rad = 0.0) {
    Scene asked = scene;  // the segmenter always looks for people and cones
    asked.cylinders.push_back({"person", {-50.0, 0.0}});
    asked.cylinders.push_back({"traffic_cone", {-50.0, 9.0}});
    stamp_s_ += period_s_;
    Frame frame = asked.render(stamp_s_, 0.0, 0.0, yaw_rad);
    spoilDepth(&random_, &frame);
    spoilLabels(sight_.erode_px, &frame);
    return map_.update(frame, rules_);
  }
  void lookFor(double duration_s, const Scene& scene, double yaw_rad = 0.0) {
    for (double t = 0.0; t < duration_s - 1e-6; t += period_s_) look(scene, yaw_rad);
  }
  /// Time until every cell within AROUND of a place is safe, once and for the second after; kMost_s
  /// and more when it does not come [s].
  double waitUntilFree(const Point2& place, const Scene& scene) {
    double since_s = stamp_s_, free_s = -1.0;
    while (stamp_s_ - since_s < 2.0 * kMost_s) {
      look(scene);
      const bool is_free = countUnsafe(place, kRadius_m + 0.3) == 0;
      if (!is_free) free_s = -1.0;
      if (is_free && free_s < 0.0) free_s = stamp_s_ - since_s;
      if (is_free && stamp_s_ - since_s > free_s + 1.0) return free_s;
    }
    return 2.0 * kMost_s;
  }
  /// Cells with their centre within a distance of a point that are not safe.
  int countUnsafe(const Point2& place, double radius_m) const {
    const SafetyGrid& grid = map_.grid();
    int n = 0;
    for (size_t i = 0; i < grid.state.size(); ++i) {
      const Point2 cell = centreOf(i);
      const double distance_m = std::hypot(cell.x - place.x, cell.y - place.y);
      const bool is_floor = isFloor(cell);
      if (is_floor && distance_m <= radius_m && grid.state[i] != CellState::kSafe) ++n;
    }
    return n;
  }
  /// Ground that the robot sees when it looks ahead, cells at the edge of its view left out.
  static bool isFloor(const Point2& cell) {
    return cell.x > 2.2 && cell.x < 7.0 && std::abs(cell.y) < 0.7 * (cell.x - 0.5) - 0.3;
  }
  Point2 centreOf(size_t i) const {
    const GridFrame& f = map_.grid().frame;
    return {(f.origin.x + static_cast<int>(i) % f.width + 0.5) * f.resolution_m,
            (f.origin.y + static_cast<int>(i) / f.width + 0.5) * f.resolution_m};
  }
  std::vector<HeldInstance> held(const std::string& class_name) const {
    std::vector<HeldInstance> found;
    for (const HeldInstance& one : map_.instances()) {
      if (one.class_name == class_name) found.push_back(one);
    }
    return found;
  }
  SemanticMap& map() { return map_; }
  double stamp_s() const { return stamp_s_; }
  double period_s() const { return period_s_; }

 private:
  Sight sight_;
  double period_s_, stamp_s_ = 100.0;
  std::mt19937 random_{4};
  Constraints rules_ = makePersonRules();
  SemanticMap map_{SemanticMapParams()};
};

CellState stateAt(const SafetyGrid& grid, double x_m, double y_m) {
  const double res = grid.frame.resolution_m;
  const int x = static_cast<int>(std::floor(x_m / res)) - grid.frame.origin.x;
  const int y = static_cast<int>(std::floor(y_m / res)) - grid.frame.origin.y;
  return grid.state[static_cast<size_t>(y) * grid.frame.width + x];
}

TEST(WhatIsNotAPerson,
     thin_thing_without_a_label_beside_one_never_becomes_safe_as_the_robot_turns) {
  for (const double x_m : {1.5, 1.9, 2.3}) {
    SemanticMap map{SemanticMapParams()};
    Scene scene;  // an unnamed class gets no label
    scene.cylinders = {{"", {x_m, -0.1}, 0.04, 0.0, 1.2}, makePerson(x_m + 0.1, 0.2)};
    const Constraints rules = makePersonRules();
    double stamp_s = 1.0, yaw_rad = 0.0;
    const auto look = [&] {
      Frame frame = scene.render(stamp_s += 0.1, 0.0, 0.0, yaw_rad);
      for (const LabelClass& c : frame.classes) {
        if (c.class_name.empty()) frame.labels.setTo(0, frame.labels == c.id);
      }
      map.update(frame, rules);
    };
    for (int k = 0; k < 20; ++k) look();
    ASSERT_NE(stateAt(map.grid(), x_m, -0.1), CellState::kSafe);
    for (; yaw_rad > -1.5; yaw_rad -= 0.005) look();
    for (int k = 0; k < 250; ++k) look();
    EXPECT_NE(stateAt(map.grid(), x_m, -0.1), CellState::kSafe) << x_m;
  }
}

TEST(WhatIsNotAPerson, arm_over_the_floor_is_held_as_the_robot_drives_up_to_it) {
  const Constraints rules = [] {
    Constraints all = makeConeRules();
    all.predicates.push_back(makePredicate(SpatialOperator::kNear, "robot_arm", Verdict::kUnsafe));
    return all;
  }();
  for (const double last_x_m : {2.3, 2.4, 2.6}) {
    SemanticMap map{SemanticMapParams()};
    Scene scene;
    scene.cylinders = {{"robot_arm", {4.0, 0.0}, 0.1, 0.85, 0.95}};
    double stamp_s = 1.0;
    for (double x_m = 0.0; x_m < last_x_m; x_m += 0.03)
      map.update(scene.render(stamp_s += 0.1, x_m, 0.0, 0.0), rules);
    for (int k = 0; k < 30; ++k)
      map.update(scene.render(stamp_s += 0.1, last_x_m, 0.0, 0.0), rules);
    EXPECT_EQ(map.instances().size(), 1u) << last_x_m;
    EXPECT_NE(stateAt(map.grid(), 3.95, 0.05), CellState::kSafe) << last_x_m;
  }
}

class Mobile : public testing::TestWithParam<Sight> {};

TEST_P(Mobile, person_who_walks_away_is_gone_from_the_barrier_in_time) {
  for (const double x_m : {2.6, 4.0, 5.4}) {
    Watch watch(GetParam());
    Scene scene;
    scene.cylinders = {makePerson(x_m, 0.0)};
    watch.lookFor(5.0, scene);
    ASSERT_EQ(watch.held("person").size(), 1u);
    ASSERT_GT(watch.countUnsafe({x_m, 0.0}, kRadius_m), 50);
    // Straight away from the robot, or across: until its AROUND does not reach the place.
    const bool across = x_m > 3.0;
    for (double gone_m = 0.0; gone_m < 3.0; gone_m += 1.2 * watch.period_s()) {
      (across ? scene.cylinders[0].centre.y : scene.cylinders[0].centre.x) +=
          1.2 * watch.period_s();
      watch.look(scene);
    }
    const double left_s = watch.waitUntilFree({x_m, 0.0}, scene);
    EXPECT_LE(left_s, kMost_s) << x_m;
  }
}

TEST_P(Mobile, person_who_vanishes_is_gone_from_the_barrier_in_time) {
  for (const double x_m : {2.6, 4.0, 5.4}) {
    Watch watch(GetParam());
    Scene scene;
    scene.cylinders = {makePerson(x_m, 0.0)};
    watch.lookFor(5.0, scene);
    const double left_s = watch.waitUntilFree({x_m, 0.0}, Scene());
    EXPECT_LE(left_s, kMost_s) << x_m;
  }
}

TEST_P(Mobile, person_who_leaves_while_the_robot_looks_elsewhere_is_gone_in_time_too) {
  for (const double away_s : {2.0, 10.0, 25.0}) {
    Watch watch(GetParam());
    Scene scene;
    scene.cylinders = {makePerson(4.0, 0.0)};
    watch.lookFor(5.0, scene);
    watch.lookFor(away_s, Scene(), 2.5);
    const int n_unsafe = watch.countUnsafe({4.0, 0.0}, 0.2);
    EXPECT_GT(n_unsafe, 0) << "nobody looked";
    const double left_s = watch.waitUntilFree({4.0, 0.0}, Scene());
    EXPECT_LE(left_s, kMost_s) << away_s;
  }
}

TEST_P(Mobile, walking_person_is_one_object_that_follows_and_leaves_no_trail) {
  Watch watch(GetParam());
  Scene scene;
  watch.lookFor(1.0, scene);
  scene.cylinders = {makePerson(4.5, -2.4)};
  std::set<uint32_t> ids;
  double worst_lag_m = 0.0, oldest_s = 0.0;
  std::map<std::pair<int, int>, double> floor_seen_s;  // since when, of cells that are not safe
  for (int k = 0; scene.cylinders[0].centre.y < 2.4; ++k) {
    Point2& person = scene.cylinders[0].centre;
    person.y += 1.2 * watch.period_s();
    const SafetyGrid& grid = watch.look(scene);
    const auto held = watch.held("person");
    if (k >= 2) {
      ASSERT_EQ(held.size(), 1u) << person.y;
      ids.insert(held[0].id);
      const Box2 box = computeBounds(held[0].footprint);
      worst_lag_m = std::max(worst_lag_m, std::abs(0.5 * (box.min_y + box.max_y) - person.y));
    }
    for (size_t i = 0; i < grid.state.size(); ++i) {
      const Point2 cell = watch.centreOf(i);
      const double gap_m = std::hypot(cell.x - person.x, cell.y - person.y);
      const auto key = std::make_pair(grid.frame.origin.x + static_cast<int>(i) % grid.frame.width,
                                      grid.frame.origin.y + static_cast<int>(i) / grid.frame.width);
      const bool is_floor = watch.isFloor(cell);
      if (!is_floor || gap_m < kRadius_m + 0.4 || grid.state[i] == CellState::kSafe) {
        floor_seen_s.erase(key);
      } else {
        floor_seen_s.emplace(key, watch.stamp_s());
        oldest_s = std::max(oldest_s, watch.stamp_s() - floor_seen_s.at(key));
      }
    }
  }
  EXPECT_LE(worst_lag_m, 0.3);
  EXPECT_LE(oldest_s, kMost_s);
  EXPECT_EQ(ids.size(), 1u);
}

TEST_P(Mobile, people_who_cross_stay_two_and_leave_no_ghost) {
  for (const double gap_m : {0.5, 1.0, 1.6}) {
    Watch watch(GetParam());
    Scene scene;
    scene.cylinders = {makePerson(3.6, -1.8), makePerson(3.6 + gap_m, 1.8)};
    watch.lookFor(1.0, scene);
    size_t fewest = 2, most = 2;
    while (scene.cylinders[0].centre.y < 1.8) {
      scene.cylinders[0].centre.y += 1.2 * watch.period_s();
      scene.cylinders[1].centre.y -= 1.2 * watch.period_s();
      watch.look(scene);
      fewest = std::min(fewest, watch.held("person").size());
      most = std::max(most, watch.held("person").size());
    }
    watch.lookFor(2.0, scene);
    EXPECT_EQ(watch.held("person").size(), 2u);
    EXPECT_EQ(fewest, 2u);
    for (const HeldInstance& one : watch.held("person")) {
      EXPECT_TRUE(one.in_view);
    }
    EXPECT_EQ(watch.countUnsafe({3.8, 0.0}, 0.2), 0);
  }
}

TEST_P(Mobile, line_of_cones_holds_while_people_walk_before_it) {
  Watch watch(GetParam());
  Scene scene = makeConeLine();
  watch.lookFor(2.0, scene);
  std::set<uint32_t> ids;
  for (const HeldInstance& cone : watch.held("traffic_cone")) ids.insert(cone.id);
  ASSERT_EQ(ids.size(), 5u);
  scene.cylinders.push_back(makePerson(3.6, -2.4));
  while (scene.cylinders.back().centre.y < 2.4) {
    scene.cylinders.back().centre.y += 1.2 * watch.period_s();
    const SafetyGrid& grid = watch.look(scene);
    for (size_t i = 0; i < grid.state.size(); ++i) {
      const Point2 cell = watch.centreOf(i);
      const bool on_line = std::abs(cell.x - 4.9) < 0.05 && std::abs(cell.y) < 2.0;
      if (on_line) {
        ASSERT_EQ(grid.state[i], CellState::kUnsafe) << cell.y;
      }
    }
  }
  scene.cylinders.pop_back();
  watch.lookFor(2.0, scene);
  ASSERT_EQ(watch.held("traffic_cone").size(), 5u);
  for (const HeldInstance& cone : watch.held("traffic_cone")) EXPECT_EQ(ids.count(cone.id), 1u);
}

INSTANTIATE_TEST_SUITE_P(sights, Mobile,
                         testing::Values(Sight{10.0, 0}, Sight{10.0, 6}, Sight{5.0, 0},
                                         Sight{5.0, 3}));

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
