// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <map>
#include <random>
#include <set>

#include "core_perception/instance_memory.h"
#include "core_perception/place_probe.h"
#include "scene.h"

namespace core_perception {
namespace {

Detection makeDetection(const Point2& centre, double edge_m = 0.3,
                        const std::string& name = "cone") {
  Detection detection;
  detection.class_name = name;
  detection.footprint = makeSquare(centre, edge_m);
  detection.cells = {
      {static_cast<int>(std::floor(centre.x / 0.2)), static_cast<int>(std::floor(centre.y / 0.2))}};
  detection.z_max_m = 0.7;
  detection.n_points = 100;
  return detection;
}

PlaceView hidden(const HeldInstance&) { return PlaceView::kHidden; }
PlaceView empty(const HeldInstance&) { return PlaceView::kEmpty; }
PlaceView other(const HeldInstance&) { return PlaceView::kOther; }
PlaceView occupied(const HeldInstance&) { return PlaceView::kOccupied; }

/// How many looks of this kind it takes to forget an object; at most 100.
int countLooks(const InstanceMemory::Probe& probe, InstanceMemory* memory) {
  int n = 0;
  for (; n < 100 && !memory->instances().empty(); ++n) memory->update(10.0 + n, {}, probe);
  return n;
}

TEST(InstanceMemory, holds_what_is_out_of_view_for_ever) {
  InstanceMemory memory{InstanceParams()};
  memory.update(1.0, {makeDetection({3, 0})}, hidden);
  EXPECT_EQ(countLooks(hidden, &memory), 100);
  EXPECT_FALSE(memory.instances()[0].in_view);
  EXPECT_DOUBLE_EQ(memory.instances()[0].last_seen_s, 1.0);
}

TEST(InstanceMemory, forgets_after_enough_looks_in_a_row_at_an_empty_place) {
  const InstanceParams params;
  InstanceMemory memory{params};
  memory.update(1.0, {makeDetection({3, 0})}, hidden);
  for (int k = 0; k < params.release_frames - 1; ++k) memory.update(2.0, {}, empty);
  memory.update(3.0, {}, hidden);
  EXPECT_EQ(memory.instances().size(), 1u) << "a look that says nothing changes nothing";
  memory.update(3.0, {}, occupied);
  EXPECT_EQ(countLooks(empty, &memory), params.release_frames) << "the count starts anew";
}

TEST(InstanceMemory, another_class_in_its_place_counts_a_fifth_of_an_empty_place) {
  const InstanceParams params;
  InstanceMemory memory{params};
  memory.update(1.0, {makeDetection({3, 0})}, hidden);
  EXPECT_EQ(countLooks(other, &memory), 5 * params.release_frames);
}

TEST(InstanceMemory, is_confirmed_by_the_second_sighting_whatever_lies_between) {
  InstanceMemory memory{InstanceParams()};
  memory.update(1.0, {makeDetection({3, 0})}, hidden);
  EXPECT_FALSE(memory.instances()[0].confirmed);
  for (int k = 0; k < 10; ++k) memory.update(2.0, {}, hidden);
  EXPECT_FALSE(memory.instances()[0].confirmed);
  memory.update(3.0, {makeDetection({3.05, 0})}, hidden);
  EXPECT_TRUE(memory.instances()[0].confirmed);
  EXPECT_EQ(memory.instances()[0].frames_seen, 2u);
}

TEST(InstanceMemory, what_moves_is_forgotten_in_time_wherever_it_was_and_what_is_at_rest_never) {
  const InstanceParams params;
  for (const auto& probe : {hidden, occupied, other}) {
    InstanceMemory memory{params};
    memory.update(1.0, {makeDetection({3, 0}, 0.4, "person"), makeDetection({5, 0})}, hidden);
    memory.update(1.0 + params.mobile_release_s, {}, probe);
    EXPECT_EQ(memory.instances().size(), 2u);
    memory.update(1.1 + params.mobile_release_s, {}, probe);
    ASSERT_EQ(memory.instances().size(), 1u);
    EXPECT_EQ(memory.instances()[0].class_name, "cone");
    memory.update(1e9, {}, hidden);
    EXPECT_EQ(memory.instances().size(), 1u);
  }
  InstanceParams never;
  never.mobile_release_s = 0.0;
  InstanceMemory memory{never};
  memory.update(1.0, {makeDetection({3, 0}, 0.4, "person")}, hidden);
  memory.update(1e9, {}, hidden);
  EXPECT_EQ(memory.instances().size(), 1u);
}

TEST(InstanceMemory, time_of_what_moves_runs_by_stamps_that_may_repeat_or_go_back) {
  const InstanceParams params;
  InstanceMemory memory{params};
  memory.update(1000.0, {makeDetection({3, 0}, 0.4, "person")}, hidden);
  for (int k = 0; k < 1000; ++k) memory.update(1000.0, {}, hidden);
  memory.update(5.0, {}, hidden);
  ASSERT_EQ(memory.instances().size(), 1u);
  EXPECT_DOUBLE_EQ(memory.instances()[0].last_seen_s, 5.0);
  memory.update(5.0 + params.mobile_release_s, {}, hidden);
  EXPECT_EQ(memory.instances().size(), 1u);
  memory.update(5.1 + params.mobile_release_s, {}, hidden);
  EXPECT_TRUE(memory.instances().empty());
}

TEST(InstanceMemory, moving_thing_is_forgotten_in_time_while_its_class_is_put_aside_too) {
  InstanceMemory memory{InstanceParams()};
  memory.update(1.0, {makeDetection({3, 0}, 0.4, "person")}, hidden);
  memory.hideClasses([](const std::string&) { return true; });
  memory.update(1e3, {}, hidden);
  memory.hideClasses([](const std::string&) { return false; });
  EXPECT_TRUE(memory.instances().empty());
}

TEST(InstanceMemory, footprint_of_what_moves_follows_however_large_it_is) {
  const InstanceParams params;
  for (const double edge_m : {0.4, 3.0}) {
    InstanceMemory memory{params};
    for (int k = 0; k <= 40; ++k) {
      const Point2 centre{3.0 + 0.15 * k, 0};
      memory.update(1.0 + 0.1 * k, {makeDetection(centre, edge_m, "truck")}, hidden);
      ASSERT_EQ(memory.instances().size(), 1u);
      const HeldInstance& held = memory.instances()[0];
      EXPECT_EQ(held.id, 1u);
      EXPECT_TRUE(held.mobile);
      EXPECT_LE(computeDiameter(held.footprint), edge_m * std::sqrt(2.0) + params.mobile_slack_m);
      EXPECT_NEAR(computeCentre(held.footprint).x, centre.x, 0.2);
      EXPECT_LE(held.cells.size(), 3u);
    }
  }
}

TEST(InstanceMemory, view_that_is_cut_off_does_not_shrink_it_and_leaves_no_trail) {
  const InstanceParams params;
  InstanceMemory memory{params};
  memory.update(1.0, {makeDetection({3, 0}, 1.2, "forklift")}, hidden);
  const double whole_m = computeDiameter(memory.instances()[0].footprint);
  memory.update(1.1, {makeDetection({4.2, 0}, 0.6, "forklift")}, hidden);
  ASSERT_EQ(memory.instances().size(), 1u);
  EXPECT_GE(computeDiameter(memory.instances()[0].footprint), whole_m);
  for (int k = 0; k <= 40; ++k) {
    memory.update(1.2 + 0.1 * k, {makeDetection({4.2 + 0.15 * k, 0}, 0.6, "forklift")}, hidden);
    EXPECT_LE(computeDiameter(memory.instances()[0].footprint),
              2.0 * whole_m + params.mobile_slack_m);
  }
}

TEST(InstanceMemory, of_two_people_one_behind_the_other_none_is_merged_away) {
  const Detection a = makeDetection({3, 0}, 0.4, "person"),
                  b = makeDetection({3, 0.6}, 0.4, "person");
  const auto cross = [](const Detection& one, const Detection& two, const Detection& both) {
    InstanceMemory memory{InstanceParams()};
    for (int k = 0; k < 3; ++k) memory.update(1.0, {one, two}, hidden);
    for (int k = 0; k < 3; ++k) memory.update(2.0, {both}, hidden);
    return memory.instances().size();
  };
  EXPECT_EQ(cross(a, b, makeDetection({3, 0.3}, 0.5, "person")), 2u);
  EXPECT_EQ(cross(makeDetection({3, 0}, 0.1), makeDetection({3, 0.3}, 0.1),
                  makeDetection({3, 0.15}, 0.5)),
            1u)
      << "two cones are one then";
}

TEST(InstanceMemory, of_too_many_the_least_dangerous_are_dropped) {
  InstanceParams params;
  params.max_instances = 4;
  InstanceMemory memory{params};
  const InstanceMemory::Danger danger{{0.0, 0.0},
                                      [](const std::string& name) { return name != "box"; }};
  std::vector<Detection> confirmed;
  for (const double x_m : {9.0, 3.0, 12.0, 6.0}) confirmed.push_back(makeDetection({x_m, 0}));
  for (int k = 0; k < 3; ++k) memory.update(1.0, confirmed, hidden, danger);
  ASSERT_EQ(memory.countDropped(), 0u);
  std::vector<Detection> ghosts;  // nearer, but of classes nothing is said of, or seen once
  for (int i = 0; i < 100; ++i) ghosts.push_back(makeDetection({1.0, 1.0 * i}, 0.3, "box"));
  for (int i = 0; i < 100; ++i) ghosts.push_back(makeDetection({-1.0, 1.0 * i}));
  memory.update(2.0, ghosts, hidden, danger);
  ASSERT_EQ(memory.instances().size(), 4u);
  const uint64_t n_dropped = memory.countDropped();
  EXPECT_EQ(n_dropped, 196u + 4u);
  EXPECT_NEAR(computeCentre(memory.instances()[0].footprint).x, 3.0, 1e-9) << "in their order";
  EXPECT_NEAR(computeCentre(memory.instances()[1].footprint).x, 6.0, 1e-9);
  for (size_t i = 2; i < 4; ++i) EXPECT_EQ(memory.instances()[i].class_name, "cone");
  // Two more that are confirmed, nearer than the farthest.
  params.max_instances = 6;
  InstanceMemory larger{params};
  for (int k = 0; k < 3; ++k) larger.update(1.0, confirmed, hidden, danger);
  const std::vector<Detection> near = {makeDetection({4.0, 0}), makeDetection({5.0, 0}),
                                       makeDetection({2.0, 0})};
  for (int k = 0; k < 3; ++k) larger.update(2.0, near, hidden, danger);
  std::set<double> left;
  for (const HeldInstance& held : larger.instances())
    left.insert(std::round(computeCentre(held.footprint).x));
  EXPECT_EQ(left, (std::set<double>{2, 3, 4, 5, 6, 9}));
}

TEST(InstanceMemory, what_is_put_aside_makes_room_first) {
  InstanceParams params;
  params.max_instances = 3;
  InstanceMemory memory{params};
  memory.update(1.0, {makeDetection({1, 0}, 0.3, "mat"), makeDetection({2, 0}, 0.3, "mat")},
                hidden);
  memory.hideClasses([](const std::string& name) { return name == "mat"; });
  memory.update(2.0, {makeDetection({8, 0}), makeDetection({9, 0})}, hidden);
  EXPECT_EQ(memory.instances().size(), 2u);
  EXPECT_EQ(memory.countDropped(), 1u);
  memory.hideClasses([](const std::string&) { return false; });
  ASSERT_EQ(memory.instances().size(), 3u);
  EXPECT_NEAR(computeCentre(memory.instances()[2].footprint).x, 1.0, 1e-9) << "the nearer one";
}

TEST(InstanceMemory, tells_neighbours_of_one_class_apart_and_keeps_their_numbers) {
  InstanceMemory memory{InstanceParams()};
  const Detection a = makeDetection({3, 0}), b = makeDetection({3, 0.6}),
                  other = makeDetection({3, 0}, 0.3, "box");
  memory.update(1.0, {a, b, other}, hidden);
  ASSERT_EQ(memory.instances().size(), 3u);
  for (int k = 0; k < 5; ++k) memory.update(2.0, {other, b, a}, hidden);  // labels in another order
  ASSERT_EQ(memory.instances().size(), 3u);
  EXPECT_NEAR(computeCentre(memory.instances()[1].footprint).y, 0.6, 1e-9);
  memory.update(3.0, {b}, hidden);
  EXPECT_FALSE(memory.instances()[0].in_view);
  EXPECT_TRUE(memory.instances()[1].in_view);
}

TEST(InstanceMemory, two_that_one_frame_tells_apart_stay_two_although_they_touch) {
  InstanceMemory memory{InstanceParams()};
  const Detection a = makeDetection({3, 0}), b = makeDetection({3, 0.25});
  for (int k = 0; k < 3; ++k) memory.update(1.0, {a, b}, hidden);
  EXPECT_EQ(memory.instances().size(), 2u);
}

TEST(InstanceMemory, footprint_is_the_hull_of_all_views_but_bounded_for_a_small_object) {
  const InstanceParams params;
  InstanceMemory memory{params};
  for (int k = 0; k <= 40; ++k)
    memory.update(1.0 + k, {makeDetection({3.0 + 0.1 * k, 0})}, hidden);  // it moves
  ASSERT_EQ(memory.instances().size(), 1u);
  const HeldInstance& held = memory.instances()[0];
  EXPECT_LE(computeDiameter(held.footprint), 0.3 * std::sqrt(2.0) + params.footprint_slack_m);
  EXPECT_TRUE(contains(held.footprint, {7.0, 0.0})) << "it is where it was seen last";
}

TEST(InstanceMemory, pieces_of_an_extended_object_grow_together) {
  InstanceMemory memory{InstanceParams()};
  memory.update(1.0, {makeDetection({0, 0}, 3.0, "rack")}, hidden);
  memory.update(2.0, {makeDetection({2, 0}, 3.0, "rack")}, hidden);
  ASSERT_EQ(memory.instances().size(), 1u);
  EXPECT_EQ(memory.instances()[0].id, 1u);
  EXPECT_TRUE(contains(memory.instances()[0].footprint, {-1.4, 0}));
  EXPECT_TRUE(contains(memory.instances()[0].footprint, {3.4, 0}));
}

TEST(InstanceMemory, held_duplicate_is_merged_when_the_object_covers_it) {
  InstanceMemory memory{InstanceParams()};
  memory.update(1.0, {makeDetection({3, 0}, 0.1), makeDetection({3.3, 0}, 0.1)}, hidden);
  ASSERT_EQ(memory.instances().size(), 2u);
  memory.update(2.0, {makeDetection({3.15, 0}, 0.5)}, hidden);
  ASSERT_EQ(memory.instances().size(), 1u);
  EXPECT_EQ(memory.instances()[0].id, 3u) << "what was said of 1 or of 2 is not said of both";
  EXPECT_EQ(memory.instances()[0].cluster, 3u);
  EXPECT_EQ(memory.instances()[0].frames_seen, 2u);
  memory.update(3.0, {makeDetection({3.15, 0}, 0.5)}, hidden);
  EXPECT_EQ(memory.instances()[0].id, 3u) << "and it keeps that number";
}

TEST(InstanceMemory, cleared_box_takes_what_reaches_into_it_put_aside_or_not) {
  InstanceMemory memory{InstanceParams()};
  memory.update(1.0,
                {makeDetection({3, 0}), makeDetection({5, 0}), makeDetection({7, 0}, 0.3, "mat")},
                hidden);
  memory.hideClasses([](const std::string& name) { return name == "mat"; });
  EXPECT_EQ(memory.clearBox({2, -1, 0.8}, {9, 1, 3.0}), 0) << "above them all";
  EXPECT_EQ(memory.clearBox({2, -1, -2.0}, {9, 1, -0.1}), 0) << "below them all";
  EXPECT_EQ(memory.clearBox({3.2, -1, 0.0}, {4.8, 1, 3.0}), 0) << "between them";
  EXPECT_EQ(memory.clearBox({3.1, -1, 0.0}, {3.3, 1, 3.0}), 1) << "it reaches in by 5 cm";
  ASSERT_EQ(memory.instances().size(), 1u);
  EXPECT_EQ(memory.instances()[0].id, 2u);
  EXPECT_EQ(memory.clearBox({6, -1, 0.0}, {8, 1, 3.0}), 1) << "the mat";
  memory.hideClasses([](const std::string&) { return false; });
  EXPECT_EQ(memory.instances().size(), 1u);
}

TEST(InstanceMemory, number_is_never_given_twice_not_even_after_clear) {
  InstanceMemory memory{InstanceParams()};
  std::set<uint32_t> given;
  for (int k = 0; k < 5; ++k) {
    memory.update(1.0, {makeDetection({3, 0}), makeDetection({3, 2})}, hidden);
    for (const HeldInstance& held : memory.instances())
      EXPECT_TRUE(given.insert(held.id).second) << held.id;
    memory.clear();
    EXPECT_TRUE(memory.instances().empty());
  }
  EXPECT_EQ(given.size(), 10u);
}

TEST(InstanceMemory, object_put_aside_is_back_unchanged_when_its_class_is_no_surface_any_more) {
  InstanceMemory memory{InstanceParams()};
  const Detection cone = makeDetection({3, 0}), box = makeDetection({5, 0}, 0.3, "box");
  for (int k = 0; k < 3; ++k) memory.update(1.0, {cone, box}, hidden);
  const HeldInstance before = memory.instances()[0];
  const auto cones = [](const std::string& name) { return name == "cone"; };
  const auto none = [](const std::string&) { return false; };
  for (int k = 0; k < 50; ++k) {
    memory.hideClasses(cones);
    memory.update(2.0, {box}, hidden);
    ASSERT_EQ(memory.instances().size(), 1u);
    EXPECT_EQ(memory.instances()[0].class_name, "box");
  }
  memory.hideClasses(none);
  memory.update(3.0, {}, hidden);
  ASSERT_EQ(memory.instances().size(), 2u);
  const HeldInstance& after = memory.instances()[1];
  EXPECT_EQ(after.id, before.id);
  EXPECT_EQ(after.class_name, "cone");
  EXPECT_TRUE(after.confirmed);
  EXPECT_FALSE(after.in_view);
  EXPECT_EQ(after.frames_seen, before.frames_seen);
  memory.hideClasses(cones);
  memory.clear();
  memory.hideClasses(none);
  EXPECT_TRUE(memory.instances().empty());
}

TEST(InstanceMemory, object_put_aside_is_released_like_any_other) {
  const InstanceParams params;
  for (int looks = params.release_frames - 1; looks <= params.release_frames; ++looks) {
    InstanceMemory memory{params};
    memory.update(1.0, {makeDetection({3, 0})}, hidden);
    memory.hideClasses([](const std::string&) { return true; });
    for (int k = 0; k < looks; ++k) memory.update(2.0, {}, empty);
    memory.hideClasses([](const std::string&) { return false; });
    EXPECT_EQ(memory.instances().empty(), looks == params.release_frames);
  }
}

TEST(InstanceDetector, splits_objects_that_share_a_label_and_drops_specks) {
  InstanceDetector detector(0.2, 8);
  detector.start({1.0, 2.0, 0.0}, 12.0);
  const auto add = [&](int16_t slot, const Eigen::Vector3d& p_m, bool standing) {
    detector.add(slot, (p_m - Eigen::Vector3d(1.0, 2.0, 0.0)).cast<float>(), standing);
  };
  for (int i = 0; i < 400; ++i) {
    add(0, {3.0 + 0.01 * (i % 20), 0.01 * (i / 20), 0.1}, true);
    add(0, {3.0 + 0.01 * (i % 20), 1.0 + 0.01 * (i / 20), 0.5}, true);
    add(1, {-3.0 + 0.01 * (i % 20), 0.01 * (i / 20), 0.1}, true);
  }
  for (int i = 0; i < 5; ++i) add(0, {6.0, 0.0, 0.0}, false);  // bled onto the background
  const std::vector<Detection> found = detector.finish({"cone", "box"});
  ASSERT_EQ(found.size(), 3u);
  EXPECT_EQ(found[2].class_name, "box");
  EXPECT_LT(computeDiameter(found[0].footprint), 0.3);
  EXPECT_EQ(found[0].n_points, 400u);
}

TEST(InstanceDetector, footprint_is_the_hull_of_the_means_of_all_bins) {
  std::mt19937 random(4);
  std::uniform_real_distribution<float> coordinate(-1.0f, 1.0f);
  // Away from the borders of bins, where rounding decides.
  const auto snap = [](float m) { return 0.01f * std::floor(100.0f * m) + 0.005f; };
  for (int round = 0; round < 200; ++round) {
    InstanceDetector detector(0.2, 1);
    detector.start(Eigen::Vector3d::Zero(), 3.0);
    struct Sum {
      double x_m = 0.0, y_m = 0.0;
      int n = 0;
    };
    std::map<std::pair<int, int>, Sum> bins;
    const float slope = coordinate(random), width_m = 0.02f + 0.3f * std::abs(coordinate(random));
    for (int i = 0; i < 3000; ++i) {
      const float x_m = snap(coordinate(random));
      const float y_m = snap(slope * x_m + width_m * coordinate(random));
      detector.add(0, {x_m, y_m, 0.5f}, true);
      Sum& sum = bins[{static_cast<int>(std::floor(x_m * 20.0f)),
                       static_cast<int>(std::floor(y_m * 20.0f))}];
      sum.x_m += x_m;
      sum.y_m += y_m;
      ++sum.n;
    }
    std::vector<Point2> means;
    for (const auto& bin : bins)
      means.push_back({bin.second.x_m / bin.second.n, bin.second.y_m / bin.second.n});
    const Polygon due = computeConvexHull(std::move(means));
    const std::vector<Detection> found = detector.finish({"rug"});
    ASSERT_EQ(found.size(), 1u);
    ASSERT_EQ(found[0].footprint.size(), due.size());
    for (size_t i = 0; i < due.size(); ++i) {
      ASSERT_NEAR(found[0].footprint[i].x, due[i].x, 1e-9);
      ASSERT_NEAR(found[0].footprint[i].y, due[i].y, 1e-9);
    }
  }
}

TEST(InstanceDetector, floor_that_got_the_label_of_a_standing_thing_does_not_stretch_it) {
  InstanceDetector detector(0.2, 8);
  detector.start({1.0, 2.0, 0.0}, 12.0);
  const auto add = [&](int16_t slot, const Eigen::Vector3d& p_m, bool standing) {
    detector.add(slot, (p_m - Eigen::Vector3d(1.0, 2.0, 0.0)).cast<float>(), standing);
  };
  for (int i = 0; i < 100; ++i) {
    add(0, {3.0 + 0.002 * i, 0.0, 0.5}, true);
    add(0, {3.2 + 0.005 * i, 0.0, 0.0}, false);
    add(1, {3.0 + 0.01 * i, 5.0, 0.0}, false);
  }
  const std::vector<Detection> found = detector.finish({"cone", "puddle"});
  ASSERT_EQ(found.size(), 2u);
  EXPECT_LT(computeDiameter(found[0].footprint), 0.3);
  EXPECT_GT(computeDiameter(found[1].footprint), 0.9) << "a flat thing keeps all its points";
}

class PlaceProbeTest : public testing::Test {
 protected:
  PlaceView look(const Scene& scene, double x_m, const Point2& place, double z_max_m = 0.7) {
    Frame frame = scene.render(1.0, x_m, 0.0, 0.0);
    if (hide_labels_) frame.labels.setTo(0);
    if (!evaluated_) frame.classes_evaluated.clear();
    cv::Mat metres;
    convertToMetres(frame.depth, &metres);
    const RangeParams range;
    const Projection projection(frame, range);
    HeldInstance held;
    held.class_name = "traffic_cone";
    held.footprint = makeSquare(place, 0.3);
    held.z_max_m = z_max_m;
    return PlaceProbe(frame, metres, projection, range, LocalFloor(range, 1.5)).look(held);
  }

  bool hide_labels_ = false, evaluated_ = true;
};

TEST_F(PlaceProbeTest, bare_floor_is_empty_and_a_cone_is_not_even_without_its_label) {
  EXPECT_EQ(look(Scene(), 0.0, {4.0, 0.5}), PlaceView::kEmpty);
  EXPECT_EQ(look(makeConeLine(), 0.0, {5.0, 0.0}), PlaceView::kOccupied);
  hide_labels_ = true;
  EXPECT_EQ(look(makeConeLine(), 0.0, {5.0, 0.0}), PlaceView::kOccupied);
  hide_labels_ = false;
  Scene statue;
  statue.cylinders = {{"statue", {5.0, 0.0}}, {"traffic_cone", {50.0, 0.0}}};
  EXPECT_EQ(look(statue, 0.0, {5.0, 0.0}), PlaceView::kOther);
  evaluated_ = false;
  EXPECT_EQ(look(statue, 0.0, {5.0, 0.0}), PlaceView::kOccupied);
}

TEST_F(PlaceProbeTest, place_out_of_view_out_of_range_or_behind_something_is_hidden) {
  EXPECT_EQ(look(Scene(), 0.0, {-3.0, 0.0}), PlaceView::kHidden);
  EXPECT_EQ(look(Scene(), 0.0, {1.0, 0.0}), PlaceView::kHidden) << "below the image";
  EXPECT_EQ(look(Scene(), 0.0, {9.0, 0.0}), PlaceView::kHidden);
  Scene screen;
  screen.cylinders = {{"screen", {3.0, 0.0}, 0.4, 0.0, 1.5}};
  EXPECT_EQ(look(screen, 0.0, {5.0, 0.0}), PlaceView::kHidden);
}

TEST_F(PlaceProbeTest, flat_thing_is_gone_only_where_its_class_was_looked_for) {
  Scene scene;
  scene.cylinders = {{"traffic_cone", {50.0, 0.0}}};
  EXPECT_EQ(look(scene, 0.0, {4.0, 0.0}, 0.02), PlaceView::kEmpty);
  evaluated_ = false;
  EXPECT_EQ(look(scene, 0.0, {4.0, 0.0}, 0.02), PlaceView::kHidden);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
