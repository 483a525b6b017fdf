// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <map>

#include "core_perception/local_floor.h"
#include "core_perception/semantic_map.h"
#include "scene.h"

namespace core_perception {
namespace {

constexpr double kCell_m = LocalFloor::kCell_m;
constexpr double kDegree = M_PI / 180.0;
using Heights = std::function<double(double x_m, double y_m)>;

/// A scene whose floor is known apart from what lies on it.
struct World {
  Scene scene;
  Heights floor = [](double, double) { return 0.0; };

  /// @param on_it height of what lies on the floor, above it.
  World(Heights floor_m, Heights on_it, double top_m) : floor(std::move(floor_m)) {
    const Heights below = floor;
    scene.ground = [below, on_it](double x, double y) { return below(x, y) + on_it(x, y); };
    scene.ground_top_m = top_m;
    scene.view = scaleCamera(Scene::camera(), 250, 320);
  }
};

double nothing(double, double) { return 0.0; }
double level(double, double) { return 0.0; }

bool isBetween(double value, double low, double high) { return value >= low && value <= high; }

/// Lies on the floor: height_m high within these bounds.
Heights makeBox(double x0, double x1, double y0, double y1, double height_m) {
  return [=](double x, double y) {
    return isBetween(x, x0, x1) && isBetween(y, y0, y1) ? height_m : 0.0;
  };
}

/// A ramp that begins at x_m and goes on.
Heights makeRamp(double x_m, double grade) {
  return [=](double x, double) { return grade * std::max(0.0, x - x_m); };
}

/// The robot's legs follow the ground below them.
Pose stand(const World& world, double x_m, double y_m, double yaw_rad) {
  const auto floorAt = [&](double ahead_m) {
    return world.floor(x_m + ahead_m * std::cos(yaw_rad), y_m + ahead_m * std::sin(yaw_rad));
  };
  const double front_m = floorAt(0.3), back_m = floorAt(-0.3);
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translate(Eigen::Vector3d(x_m, y_m, 0.5 * (front_m + back_m)));
  T.rotate(Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()));
  T.rotate(Eigen::AngleAxisd(-std::atan2(front_m - back_m, 0.6), Eigen::Vector3d::UnitY()));
  return T * Eigen::Isometry3d(Scene::pose(0.0, 0.0, 0.0));
}

/// What heights above the local floor make of a column of the map.
struct Verdict {
  int n_floor = 0, n_false = 0;      ///< points of the floor; those taken for an obstacle or a drop
  int n_obstacle = 0, n_missed = 0;  ///< points of an obstacle; those taken for floor
};

/// How the columns of a frame are told apart, where three points make an obstacle.
struct Score {
  int n_floor = 0, n_false = 0;
  int n_obstacles = 0, n_missed = 0;
  double false_share() const { return static_cast<double>(n_false) / std::max(1, n_floor); }
};

/// A robot that looks at a world, and is perhaps wrong about where it is.
class Walker {
 public:
  explicit Walker(World world) : world_(std::move(world)) {}

  double drift_m = 0.0;          ///< of the height that odometry gives
  double pitch_error_rad = 0.0;  ///< of the camera, positive looks up
  bool noisy = true;

  void look(double x_m, double y_m, double yaw_rad) {
    T_true_ = stand(world_, x_m, y_m, yaw_rad);
    seen_ = world_.scene.render(1.0, x_m, y_m, T_true_);
    true_depth_ = seen_.depth.clone();
    lookAgain();
  }
  /// At the same image from the same place.
  void lookAgain() {
    seen_.depth = true_depth_.clone();
    if (noisy) addStereoNoise(&random_, &seen_);
    Eigen::Isometry3d T(T_true_);
    T.pretranslate(Eigen::Vector3d(0.0, 0.0, drift_m));
    T.rotate(Eigen::AngleAxisd(pitch_error_rad, Eigen::Vector3d::UnitX()));
    seen_.T_map_camera = T;
    convertToMetres(seen_.depth, &metres_);
    floor_.update(metres_, Projection(seen_, range_), seen_.p_map_base);
  }
  void walk(double from_x_m, double to_x_m, double step_m) {
    const double yaw_rad = to_x_m > from_x_m ? 0.0 : M_PI;
    const int n = static_cast<int>(std::lround(std::abs(to_x_m - from_x_m) / step_m));
    for (int i = 0; i <= n; ++i) look(from_x_m + (to_x_m - from_x_m) * i / n, 0.0, yaw_rad);
  }

  /// @param farthest_m points beyond this depth are left out.
  Score score(double farthest_m = 7.0) const {
    std::map<std::pair<int, int>, Verdict> verdicts;
    const Projection told(seen_, range_);
    Frame truth = seen_;
    truth.T_map_camera = T_true_;
    const Projection projection(truth, range_);
    PointRow row;
    for (int v = 0; v < seen_.depth.rows; ++v) {
      told.projectRow(metres_, v, &row);
      for (int u = row.first; u < row.end; ++u) {
        const float depth_m = row.depth_m[u], true_m = true_depth_.at<float>(v, u);
        if (depth_m == 0.0f || depth_m > farthest_m || !(true_m <= farthest_m)) continue;
        const Eigen::Vector3d p = T_true_.translation() + projection.computePoint(u, v, true_m);
        judge(p, told.p_map_camera() + told.computePoint(u, v, depth_m), depth_m,
              &verdicts[{toIndex(p.x()), toIndex(p.y())}]);
      }
    }
    Score score;
    for (const auto& column : verdicts) {
      const Verdict& verdict = column.second;
      score.n_floor += verdict.n_floor >= 3;
      score.n_false += verdict.n_false >= 3 && verdict.n_obstacle == 0;
      score.n_obstacles += verdict.n_obstacle >= 3;
      score.n_missed += verdict.n_obstacle >= 3 && verdict.n_obstacle - verdict.n_missed < 3;
    }
    return score;
  }
  float heightAt(double x_m, double y_m) const { return floor_.height_m(x_m, y_m); }
  FloorState stateAt(double x_m, double y_m) const { return floor_.state(x_m, y_m); }
  LocalFloor& floor() { return floor_; }
  World& world() { return world_; }

 private:
  static int toIndex(double m) { return static_cast<int>(std::floor(m / kCell_m)); }

  void judge(const Eigen::Vector3d& p_true, const Eigen::Vector3d& p, float depth_m,
             Verdict* verdict) const {
    const double standing_m = p_true.z() - world_.floor(p_true.x(), p_true.y());
    const double height_m = p.z() - heightAt(p.x(), p.y());
    const double limit_m = range_.metric_min_height_m + range_.metric_slope * depth_m;
    if (standing_m < 0.005) {
      ++verdict->n_floor;
      if (std::abs(height_m) >= limit_m) ++verdict->n_false;
    } else if (standing_m > limit_m + 0.04 && standing_m < 0.85) {
      ++verdict->n_obstacle;
      if (height_m < limit_m) ++verdict->n_missed;
    }
  }

  World world_;
  RangeParams range_;
  LocalFloor floor_{RangeParams(), 1.5};
  std::mt19937 random_{7};
  Pose T_true_ = Pose::Identity();
  Frame seen_;
  cv::Mat true_depth_, metres_;
};

constexpr double kFewFalse = 0.005;  // of the columns in view

TEST(LocalFloor, is_level_on_level_ground) {
  Walker walker(World(level, nothing, 0.0));
  walker.walk(0.0, 1.0, 0.2);
  for (double x = -0.3; x < 6.0; x += 0.2) EXPECT_NEAR(walker.heightAt(x, 0.0), 0.0, 0.03) << x;
  EXPECT_EQ(walker.stateAt(0.9, 0.0), FloorState::kHeld);
  EXPECT_EQ(walker.stateAt(4.1, 0.0), FloorState::kSeen);
  EXPECT_EQ(walker.stateAt(-5.1, 0.0), FloorState::kAssumed);
  EXPECT_GT(walker.score().n_floor, 400);
  EXPECT_EQ(walker.score().false_share(), 0.0);
}

TEST(LocalFloor, takes_a_kerb_up_and_down_as_floor) {
  const Heights kerb = [](double x, double) { return x > 3.1 && x < 6.1 ? 0.08 : 0.0; };
  Walker walker(World(kerb, makeBox(4.5, 4.8, 0.3, 0.6, 0.2), 0.3));
  for (double x = 0.0; x <= 6.0; x += 0.25) {
    walker.look(x, 0.0, 0.0);
    const Score score = walker.score();
    EXPECT_LE(score.false_share(), kFewFalse) << x;
    EXPECT_EQ(score.n_missed, 0) << x << " of " << score.n_obstacles;
  }
  EXPECT_NEAR(walker.heightAt(5.5, 0.0), 0.08, 0.02);
}

class Ramp : public ::testing::TestWithParam<double> {};

TEST_P(Ramp, is_floor_and_what_stands_on_it_is_not) {
  const double grade = GetParam();
  Walker walker(World(makeRamp(2.5, grade), makeBox(7.0, 7.4, -0.2, 0.2, 0.2),
                      std::max(0.0, 13.0 * grade) + 0.2));
  int n_obstacles = 0;
  for (double x = 0.0; x <= 5.6; x += 0.2) {
    walker.look(x, 0.0, 0.0);
    const Score score = walker.score(5.0);
    EXPECT_LE(score.false_share(), kFewFalse) << x;
    EXPECT_EQ(score.n_missed, 0) << x << " of " << score.n_obstacles;
    n_obstacles += score.n_obstacles;
  }
  EXPECT_GT(n_obstacles, 50);
  EXPECT_NEAR(walker.heightAt(5.1, 0.0), grade * 2.6, 0.06);
}

INSTANTIATE_TEST_CASE_P(LocalFloor, Ramp, ::testing::Values(-0.15, -0.1, -0.05, 0.05, 0.1, 0.15));

TEST(LocalFloor, never_climbs_a_ledge) {
  // In turn before the robot, at its side, and as an island.
  const Heights ledges[] = {makeBox(3.05, 20.0, -20.0, 20.0, 0.15),
                            makeBox(-20.0, 20.0, 0.65, 20.0, 0.15),
                            makeBox(3.05, 4.0, -0.5, 0.5, 0.15)};
  for (const Heights& ledge : ledges) {
    Walker walker(World(level, ledge, 0.15));
    int n_obstacles = 0;
    for (double x = 0.0; x <= 1.8; x += 0.1) {
      walker.look(x, 0.0, 0.0);
      for (double at = 3.5; at <= 5.0; at += 0.2)
        EXPECT_LT(walker.heightAt(at, 0.0), 0.05f) << x << " at " << at;
      EXPECT_EQ(walker.score().n_missed, 0) << x;
      EXPECT_LE(walker.score().false_share(), kFewFalse) << x;
      n_obstacles += walker.score().n_obstacles;
    }
    EXPECT_GT(n_obstacles, 0);
  }
}

TEST(LocalFloor, never_goes_down_a_drop) {
  const Heights pit = [](double x, double) { return x > 3.05 ? -0.15 : 0.0; };
  Walker walker(World(pit, nothing, 0.0));
  for (double x = 0.0; x <= 2.2; x += 0.1) {
    walker.look(x, 0.0, 0.0);
    for (double at = 3.5; at <= 5.0; at += 0.2)
      EXPECT_GT(walker.heightAt(at, 0.0), -0.05f) << x << " at " << at;
  }
  EXPECT_EQ(walker.stateAt(4.5, 0.0), FloorState::kDrop);
}

/// Walks round the place (3, 0) at this distance and looks at it.
void expectNeverFloor(Walker* walker, double distance_m) {
  int n_obstacles = 0;
  for (int i = 0; i < 36; ++i) {
    const double angle = M_PI + i * 10.0 * kDegree;
    walker->look(3.0 + distance_m * std::cos(angle), distance_m * std::sin(angle), angle - M_PI);
    const Score score = walker->score();
    EXPECT_EQ(score.n_missed, 0) << i << " of " << score.n_obstacles;
    EXPECT_LE(score.false_share(), kFewFalse) << i;
    n_obstacles += score.n_obstacles;
  }
  EXPECT_GT(n_obstacles, 50);
  EXPECT_LT(walker->heightAt(3.0, 0.0), 0.03);
}

TEST(LocalFloor, never_takes_a_box_for_floor_from_any_side) {
  for (const double distance_m : {3.0, 1.6}) {
    Walker walker(World(level, makeBox(2.4, 3.6, -0.5, 0.5, 0.3), 0.3));
    expectNeverFloor(&walker, distance_m);
  }
}

TEST(LocalFloor, never_takes_somebody_who_lies_for_floor) {
  // 1.7 m long, rounded to 0.25 m at the trunk and 0.12 m at the legs, the feet up again.
  const Heights body = [](double x, double y) {
    const double along = x - 2.15;
    if (!isBetween(along, 0.0, 1.7)) return 0.0;
    const double half = along < 0.85 ? 0.18 : 0.24;
    const double top = along < 0.12 ? 0.22 : along < 0.85 ? 0.12 : 0.25;
    const double part = y / half;
    return std::abs(part) < 1.0 ? top * std::sqrt(1.0 - part * part) : 0.0;
  };
  for (const double distance_m : {3.2, 2.2}) {
    Walker walker(World(level, body, 0.25));
    expectNeverFloor(&walker, distance_m);
  }
}

TEST(LocalFloor, sees_the_floor_below_a_table) {
  World world(level, nothing, 0.0);
  world.scene.cylinders = {{"table", {3.5, 0.0}, 0.6, 0.68, 0.72}};
  Walker walker(world);
  for (double x = 0.0; x <= 1.5; x += 0.25) {
    walker.look(x, 0.0, 0.0);
    EXPECT_EQ(walker.score().n_missed, 0);
    EXPECT_NEAR(walker.heightAt(3.5, 0.0), 0.0, 0.03);
  }
}

TEST(LocalFloor, never_climbs_stairs) {
  for (const double rise_m : {0.08, 0.15}) {
    const Heights stairs = [rise_m](double x, double) {
      return x < 3.0 ? 0.0 : rise_m * std::min(6.0, 1.0 + std::floor((x - 3.0) / 0.28));
    };
    Walker walker(World(level, stairs, 1.0));
    for (double x = 0.0; x <= 2.2; x += 0.1) {
      walker.look(x, 0.0, 0.0);
      for (double at = 3.7; at < 4.7; at += 0.2)
        EXPECT_LT(walker.heightAt(at, 0.0), 0.1f) << rise_m << ", " << x << " at " << at;
    }
  }
}

TEST(LocalFloor, never_takes_a_box_for_floor_of_which_only_the_top_is_in_view) {
  // From the start its front lies below the image.
  Walker walker(World(level, makeBox(1.2, 9.0, -4.0, 4.0, 0.25), 0.25));
  for (int i = 0; i < 5; ++i) {
    walker.look(0.0, 0.0, 0.0);
    const Score score = walker.score();
    EXPECT_GT(score.n_obstacles, 200);
    EXPECT_EQ(score.n_missed, 0);
  }
}

TEST(LocalFloor, never_takes_the_upper_part_of_a_box_for_floor_whose_foot_is_hidden) {
  // All across the view, so that no floor is seen beside them.
  const Heights near = makeBox(2.4, 2.6, -9.0, 9.0, 0.18), far = makeBox(3.05, 9.0, -9.0, 9.0, 0.2);
  Walker walker(World(level, [=](double x, double y) { return near(x, y) + far(x, y); }, 0.2));
  walker.look(0.0, 0.0, 0.0);
  const Score score = walker.score(4.0);
  EXPECT_GT(score.n_obstacles, 100);
  EXPECT_EQ(score.n_missed, 0);
}

TEST(LocalFloor, never_follows_what_rises_slowly) {
  Walker walker(World(level, nothing, 0.4));
  for (int mm = 0; mm <= 300; mm += 4) {
    walker.world().scene.ground = makeBox(2.4, 4.2, -1.0, 1.0, 0.001 * mm);
    for (int i = 0; i < 4; ++i) i == 0 ? walker.look(0.0, 0.0, 0.0) : walker.lookAgain();
    EXPECT_LT(walker.heightAt(3.3, 0.0), 0.1f) << mm;
    EXPECT_NEAR(walker.heightAt(0.0, 0.0), 0.0, 0.01) << "below the robot, at " << mm;
    EXPECT_EQ(walker.score().n_missed, 0) << mm;
  }
}

TEST(LocalFloor, does_not_climb_points_between_an_edge_and_what_lies_behind) {
  // A wall 0.3 m high all across the view; the camera smears its upper edge over the floor behind.
  const double edge_x = 2.9, slope = 0.35 / (edge_x - 0.5);
  const Heights smear = [=](double x, double) {
    return x < 2.7 ? 0.0 : x < edge_x ? 0.3 : std::max(0.0, 0.3 - 0.98 * slope * (x - edge_x));
  };
  Walker walker(World(level, smear, 0.3));
  for (int i = 0; i < 5; ++i) {
    walker.look(0.0, 0.0, 0.0);
    for (double at = 2.8; at < 5.5; at += 0.2) EXPECT_LT(walker.heightAt(at, 0.0), 0.1f) << at;
  }
}

TEST(LocalFloor, follows_a_height_that_drifts_while_the_robot_walks) {
  for (const double last_m : {0.3, -0.3}) {
    Walker walker(World(level, makeBox(9.0, 9.4, 0.6, 1.2, 0.2), 0.2));
    // There and back: what it held is wrong by the whole drift then.
    for (int i = 0; i <= 140; ++i) {
      walker.drift_m = last_m * i / 140.0;
      walker.look(0.2 * (i <= 70 ? i : 140 - i), 0.0, i <= 70 ? 0.0 : M_PI);
      const Score score = walker.score(6.0);
      EXPECT_LE(score.false_share(), kFewFalse) << i;
      EXPECT_EQ(score.n_missed, 0) << i;
    }
    EXPECT_NEAR(walker.heightAt(-2.0, 0.0), last_m, 0.02);
  }
}

TEST(LocalFloor, follows_a_height_that_drifts_while_the_robot_stands) {
  Walker walker(World(level, makeBox(4.0, 4.4, -0.3, 0.3, 0.2), 0.2));
  walker.look(0.0, 0.0, 0.0);
  for (int i = 0; i <= 1000; ++i) {
    walker.drift_m = 0.0003 * i;
    walker.lookAgain();
  }
  EXPECT_NEAR(walker.heightAt(0.0, 0.0), 0.3, 0.02) << "below the robot";
  EXPECT_EQ(walker.score().n_missed, 0);
  EXPECT_LE(walker.score().false_share(), kFewFalse);
}

TEST(LocalFloor, bears_an_error_of_pitch) {
  for (const double error_deg : {1.0, -1.0}) {
    Walker walker(World(level, makeBox(5.0, 5.4, -0.3, 0.3, 0.25), 0.25));
    walker.pitch_error_rad = error_deg * kDegree;
    for (double x = 0.0; x <= 3.0; x += 0.1) {
      walker.look(x, 0.0, 0.0);
      EXPECT_LE(walker.score().false_share(), kFewFalse) << error_deg << " at " << x;
      EXPECT_EQ(walker.score().n_missed, 0) << error_deg << " at " << x;
    }
  }
}

TEST(LocalFloor, bears_a_camera_that_nods) {
  Walker walker(World(level, makeBox(5.0, 5.4, -0.3, 0.3, 0.25), 0.25));
  for (int i = 0; i <= 60; ++i) {
    walker.pitch_error_rad = kDegree * std::sin(0.7 * i);
    walker.look(0.05 * i, 0.0, 0.0);
    EXPECT_LE(walker.score().false_share(), kFewFalse) << i;
    EXPECT_EQ(walker.score().n_missed, 0) << i;
  }
}

TEST(LocalFloor, holds_no_more_memory_however_far_it_goes) {
  Walker walker(World(level, nothing, 0.0));
  walker.look(0.0, 0.0, 0.0);
  const size_t before = walker.floor().size();
  for (double x = 0.0; x < 400.0; x += 20.0) walker.look(x, 0.0, 0.0);
  EXPECT_EQ(walker.floor().size(), before);
  EXPECT_EQ(walker.stateAt(0.0, 0.0), FloorState::kAssumed);
}

TEST(LocalFloor, begins_anew_when_it_is_cleared) {
  Walker walker(World(makeRamp(2.5, 0.1), nothing, 2.0));
  walker.walk(0.0, 5.0, 0.25);
  ASSERT_GT(walker.heightAt(5.0, 0.0), 0.2);
  walker.floor().clear();
  EXPECT_EQ(walker.heightAt(5.0, 0.0), 0.0);
  EXPECT_EQ(walker.stateAt(8.0, 0.0), FloorState::kAssumed);
  walker.lookAgain();
  EXPECT_NEAR(walker.heightAt(5.0, 0.0), 0.25, 0.05) << "below the camera as at the start";
}

/// The map that a robot makes as it walks.
class Mapper {
 public:
  Mapper(World world, bool local_floor)
      : world_(std::move(world)), map_([local_floor] {
          SemanticMapParams params;
          params.range.local_floor = local_floor;
          return params;
        }()) {}

  double drift_m = 0.0;

  void look(double x_m, double yaw_rad) {
    const Pose T_true = stand(world_, x_m, 0.0, yaw_rad);
    Frame frame = world_.scene.render(stamp_s_ += 0.1, x_m, 0.0, T_true);
    addStereoNoise(&random_, &frame);
    frame.T_map_camera.translation().z() += drift_m;
    map_.update(frame, makeConeRules());
  }
  void walk(double to_x_m, double step_m) {
    for (double x = 0.0; x < to_x_m + 0.5 * step_m; x += step_m) look(x, 0.0);
  }
  /// How many cells of the way ahead are in that state.
  int count(CellState state, double from_x_m, double to_x_m) const {
    int n = 0;
    for (double x = from_x_m; x < to_x_m; x += kCell_m) n += stateAt(x, 0.0) == state;
    return n;
  }
  CellState stateAt(double x_m, double y_m) const {
    const GridFrame& frame = map_.grid().frame;
    const int x = static_cast<int>(std::floor(x_m / frame.resolution_m)) - frame.origin.x;
    const int y = static_cast<int>(std::floor(y_m / frame.resolution_m)) - frame.origin.y;
    return map_.grid().state[static_cast<size_t>(y) * frame.width + x];
  }
  SemanticMap& map() { return map_; }

 private:
  World world_;
  SemanticMap map_;
  std::mt19937 random_{7};
  double stamp_s_ = 0.0;
};

TEST(UnevenGround, a_ramp_is_safe_and_what_stands_on_it_is_not) {
  for (const double grade : {0.1, -0.1}) {
    World world(makeRamp(2.5, grade), makeBox(7.0, 7.4, -0.3, 0.3, 0.3), grade > 0.0 ? 1.3 : 0.0);
    for (const double y : {-1.2, 1.2})
      world.scene.cylinders.push_back(
          {"traffic_cone", {6.0, y}, 0.15, 3.5 * grade, 3.5 * grade + 0.7});
    Mapper with(world, true), without(world, false);
    for (Mapper* mapper : {&with, &without}) mapper->walk(4.0, 0.2);
    EXPECT_EQ(with.count(CellState::kSafe, 0.1, 5.6), 28) << grade;
    EXPECT_EQ(with.stateAt(7.1, 0.0), CellState::kUnsafe);
    EXPECT_EQ(with.map().instances().size(), 2u);
    EXPECT_EQ(with.stateAt(6.0, 0.0), CellState::kUnsafe) << "between the cones";
    EXPECT_LT(without.count(CellState::kSafe, 0.1, 5.6), 24) << "with level floor " << grade;
  }
}

TEST(UnevenGround, ground_behind_a_drop_is_never_safe) {
  for (const double depth_m : {0.15, 0.3, 1.0}) {
    const Heights pit = [depth_m](double x, double) { return x > 3.05 ? -depth_m : 0.0; };
    Mapper mapper(World(pit, nothing, 0.0), true);
    mapper.walk(2.0, 0.1);
    EXPECT_EQ(mapper.count(CellState::kSafe, 3.3, 5.0), 0) << depth_m;
    EXPECT_EQ(mapper.count(CellState::kSafe, 0.1, 2.9), 14) << depth_m;
  }
}

TEST(UnevenGround, a_height_that_drifts_makes_no_obstacles_and_clears_none) {
  const World world(level, makeBox(14.0, 14.4, -0.3, 0.3, 0.2), 0.2);
  Mapper with(world, true), without(world, false);
  for (int i = 0; i <= 60; ++i) {
    for (Mapper* mapper : {&with, &without}) {
      mapper->drift_m = 0.005 * i;
      mapper->look(0.2 * i, 0.0);
    }
  }
  EXPECT_EQ(with.count(CellState::kSafe, 5.1, 13.8), 44);
  EXPECT_EQ(with.stateAt(14.1, 0.0), CellState::kUnsafe);
  EXPECT_LT(without.count(CellState::kSafe, 5.1, 13.8), 30) << "with level floor";
}

TEST(UnevenGround, a_map_that_is_cleared_begins_at_the_height_of_the_robot) {
  // Level ground around the robot is all that it can begin with.
  Mapper landing(World([](double x, double) { return 0.1 * std::min(2.0, std::max(0.0, x - 1.0)); },
                       nothing, 0.3),
                 true);
  landing.walk(5.0, 0.2);
  landing.map().clear();
  for (int i = 0; i < 3; ++i) landing.look(5.0, 0.0);
  EXPECT_EQ(landing.count(CellState::kSafe, 5.1, 9.0), 20);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
