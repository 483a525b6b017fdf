// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

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
    return PlaceProbe(frame, metres, projection, range).look(held);
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
