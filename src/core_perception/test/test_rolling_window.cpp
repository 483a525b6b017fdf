// SPDX-License-Identifier: BSD-3-Clause
#include <dirent.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <fstream>
#include <functional>
#include <random>
#include <thread>

#include "core_perception/exceptions.h"
#include "core_perception/semantic_map.h"
#include "core_perception/tree_snapshot.h"
#include "scene.h"

namespace core_perception {
namespace {

std::vector<std::string> listFolder(const std::string& folder) {
  std::vector<std::string> names;
  DIR* directory = ::opendir(folder.c_str());
  while (const dirent* entry = ::readdir(directory)) {
    if (entry->d_name[0] != '.') names.push_back(folder + "/" + entry->d_name);
  }
  ::closedir(directory);
  return names;
}

/// A folder for one test.
struct Folder {
  Folder() { EXPECT_NE(::mkdtemp(&path[0]), nullptr); }
  ~Folder() { ::rmdir(path.c_str()); }
  std::string path = "/tmp/core_rolling_XXXXXX";

  std::vector<std::string> tiles() const {
    std::vector<std::string> files;
    for (const std::string& run : listFolder(path)) {
      for (const std::string& file : listFolder(run)) {
        if (file.find(".tile") != std::string::npos) files.push_back(file);
      }
    }
    return files;
  }
};

bool waitFor(const std::function<bool()>& condition) {
  for (int i = 0; i < 2000 && !condition(); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  return condition();
}

/// Small ranges, so that the walk can be short: the camera reaches 5.6 m, tiles leave 14.4 m away.
SemanticMapParams makeParams(double keep_radius_m, const std::string& outside,
                             const std::string& folder) {
  SemanticMapParams p;
  p.window_m = 6.0;
  p.range.range_max_m = 4.0;
  p.window.keep_radius_m = keep_radius_m;
  p.window.outside = outside;
  p.window.tile_dir = folder;
  return p;
}

/// Cones, lamps under the ceiling and statues along the x axis.
Scene makeAlley() {
  Scene scene;
  scene.cylinders.push_back({"barrel", {5.0, -1.8}});
  for (int i = 0; i < 7; ++i) {
    const double x_m = 3.0 + 6.0 * i;
    scene.cylinders.push_back({"traffic_cone", {x_m, -0.6}});
    scene.cylinders.push_back({"traffic_cone", {x_m, 0.7}});
    scene.cylinders.push_back({"statue", {x_m + 2.0, 1.6}});
    scene.cylinders.push_back({"lamp", {x_m + 1.0, -1.0}, 0.2, 1.2, 1.5});
  }
  return scene;
}

constexpr double kFarEnd_m = 36.0;

/// Frames of a walk along the x axis to its far end and back again, always looking along x.
const std::vector<Frame>& walk() {
  static const std::vector<Frame> frames = [] {
    std::vector<Frame> all;
    const Scene scene = makeAlley();
    double stamp_s = 1.0;
    for (double x = 0.0; x < kFarEnd_m; x += 0.5)
      all.push_back(scene.render(stamp_s += 0.1, x, 0, 0));
    for (double x = kFarEnd_m; x > -0.1; x -= 0.5)
      all.push_back(scene.render(stamp_s += 0.1, x, 0, 0));
    return all;
  }();
  return frames;
}

size_t countOut() { return walk().size() / 2; }

Constraints makeRules(double barrel_m) {
  Constraints rules = makeConeRules();
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kAround, "statue", Verdict::kUnsafe, 1.0));
  rules.predicates.push_back(
      makePredicate(SpatialOperator::kAround, "barrel", Verdict::kUnsafe, barrel_m));
  return rules;
}

std::string ruleOf(const SafetyGrid& grid, size_t i) {
  const uint16_t cause = grid.cause[i];
  return cause == kNoCause ? "" : grid.causes[cause].rule + grid.causes[cause].class_name;
}

void expectSameGrid(const SafetyGrid& a, const SafetyGrid& b, const std::string& where) {
  ASSERT_EQ(a.frame.origin, b.frame.origin) << where;
  EXPECT_EQ(a.n_safe, b.n_safe) << where;
  EXPECT_EQ(a.n_unsafe, b.n_unsafe) << where;
  EXPECT_TRUE(a.state == b.state) << where;
  EXPECT_EQ(a.h_m, b.h_m) << where;
  for (size_t i = 0; i < a.state.size(); ++i)
    ASSERT_EQ(ruleOf(a, i), ruleOf(b, i)) << where << " cell " << i;
}

CellState stateAt(const SafetyGrid& grid, double x_m, double y_m) {
  const int x = static_cast<int>(std::floor(x_m / grid.frame.resolution_m)) - grid.frame.origin.x;
  const int y = static_cast<int>(std::floor(y_m / grid.frame.resolution_m)) - grid.frame.origin.y;
  return grid.state[static_cast<size_t>(y) * grid.frame.width + x];
}

std::map<uint32_t, HeldInstance> byNumber(const SemanticMap& map) {
  std::map<uint32_t, HeldInstance> all;
  for (const HeldInstance& held : map.instances()) all[held.id] = held;
  return all;
}

/// Whatever both hold is the same.
void expectSameMemory(SemanticMap* window, SemanticMap* whole) {
  size_t n = 0;
  const auto end = window->votes().tree().end_leafs();
  for (auto leaf = window->votes().tree().begin_leafs(); leaf != end; ++leaf, ++n) {
    const SemanticOcTreeNode* other = whole->votes().tree().find(leaf.getKey());
    ASSERT_NE(other, nullptr);
    ASSERT_TRUE(*leaf == *other);
  }
  EXPECT_GT(n, 100u);
  for (int x = -40; x < 250; ++x) {
    for (int y = -40; y < 40; ++y) {
      const Column *own = window->votes().find(x, y), *other = whole->votes().find(x, y);
      if (own == nullptr) continue;
      ASSERT_NE(other, nullptr);
      ASSERT_EQ(own->counts, other->counts);
      ASSERT_EQ(own->cause, other->cause);
      ASSERT_EQ(own->cause_frame, other->cause_frame);
      ASSERT_EQ(own->derived_frame, other->derived_frame);
    }
  }
  const auto held = byNumber(*window), all = byNumber(*whole);
  for (const auto& one : held) {
    ASSERT_EQ(all.count(one.first), 1u) << one.first;
    const HeldInstance& other = all.at(one.first);
    EXPECT_EQ(one.second.cells, other.cells);
    EXPECT_EQ(one.second.cluster, other.cluster);
    EXPECT_EQ(one.second.frames_seen, other.frames_seen);
    EXPECT_EQ(one.second.doubt, other.doubt);
    EXPECT_EQ(one.second.last_seen_s, other.last_seen_s);
  }
}

TEST(RollingWindow, ground_on_disk_comes_back_as_if_it_had_never_left) {
  const Folder folder;
  SemanticMap whole{makeParams(0.0, "drop", "")};
  SemanticMap window{makeParams(8.0, "disk", folder.path)};
  size_t most_tiles = 0, most_away = 0;
  for (int lap = 0; lap < 2; ++lap) {
    for (size_t k = 0; k < walk().size(); ++k) {
      Frame frame = walk()[k];
      frame.stamp_s += 100.0 * lap;
      whole.update(frame, makeRules(1.0));
      window.update(frame, makeRules(1.0));
      expectSameGrid(window.grid(), whole.grid(), "frame " + std::to_string(k));
      if (testing::Test::HasFailure()) return;
      if (k % 10 == 0) expectSameMemory(&window, &whole);
      most_tiles = std::max(most_tiles, window.votes().listTiles().size());
      if (k + 1 == countOut()) {
        EXPECT_LT(window.instances().size(), whole.instances().size());
      }
      most_away = std::max(most_away, window.windowStatus().away.tiles);
    }
  }
  EXPECT_LT(most_tiles, whole.votes().listTiles().size());
  EXPECT_GE(most_away, 4u);
  EXPECT_EQ(window.windowStatus().away.lost, 0u);
  EXPECT_EQ(stateAt(window.grid(), 0.0, 0.0), CellState::kSafe) << "the initial disc";
}

TEST(RollingWindow, dropped_ground_is_unknown_when_the_robot_comes_back) {
  SemanticMap whole{makeParams(0.0, "drop", "")}, window{makeParams(8.0, "drop", "")};
  size_t most_tiles = 0, n_unknown = 0;
  for (size_t k = 0; k < walk().size(); ++k) {
    whole.update(walk()[k], makeRules(1.0));
    window.update(walk()[k], makeRules(1.0));
    most_tiles = std::max(most_tiles, window.votes().listTiles().size());
    if (k == 0) {
      EXPECT_EQ(stateAt(window.grid(), 0.0, 0.0), CellState::kSafe);
    }
    // Behind the robot, seen on the way out alone.
    const double x_m = walk()[k].p_map_base.x - 2.0;
    if (k < countOut() || x_m < 8.0 || x_m > 12.0) continue;
    EXPECT_FALSE(stateAt(whole.grid(), x_m, 0.1) == CellState::kUnknown) << x_m;
    EXPECT_FALSE(stateAt(window.grid(), x_m, 0.1) == CellState::kSafe) << x_m;
    n_unknown += stateAt(window.grid(), x_m, 0.1) == CellState::kUnknown;
  }
  EXPECT_GE(n_unknown, 6u) << "apart from between two remembered cones";
  EXPECT_LT(most_tiles, whole.votes().listTiles().size());
  EXPECT_EQ(stateAt(window.grid(), 0.0, 0.0), CellState::kUnknown)
      << "the disc is not a second one";
  EXPECT_EQ(stateAt(whole.grid(), 0.0, 0.0), CellState::kSafe);
  EXPECT_LT(window.instances().size(), whole.instances().size());
}

TEST(RollingWindow, no_region_of_a_hazard_opens_while_the_robot_walks_away) {
  for (const double barrel_m : {1.0, 18.0}) {
    SemanticMap whole{makeParams(0.0, "drop", "")}, window{makeParams(8.0, "drop", "")};
    for (size_t k = 0; k < countOut(); ++k) {
      whole.update(walk()[k], makeRules(barrel_m));
      window.update(walk()[k], makeRules(barrel_m));
      for (size_t i = 0; i < whole.grid().state.size(); ++i) {
        if (window.grid().state[i] != CellState::kSafe) continue;
        ASSERT_EQ(whole.grid().state[i], CellState::kSafe) << barrel_m << " m, frame " << k;
      }
    }
    EXPECT_LT(window.votes().listTiles().size(), whole.votes().listTiles().size());
  }
}

/// A cluster all members of which are far, around ground that is near.
TEST(RollingWindow, cluster_stays_while_its_hull_covers_the_robot) {
  InstanceParams params;
  params.min_frames = 1;
  InstanceMemory memory{params};
  std::vector<Detection> ring;
  for (int i = 0; i < 100; ++i) {
    Detection cone;
    cone.class_name = "traffic_cone";
    const double angle = 2.0 * M_PI * i / 100;
    cone.footprint = makeSquare({30.0 * std::cos(angle), 30.0 * std::sin(angle)}, 0.2);
    ring.push_back(cone);
  }
  memory.update(1.0, ring, [](const HeldInstance&) { return PlaceView::kHidden; });
  memory.keepAround({0.0, 0.0}, 10.0, 11.0, true);
  EXPECT_EQ(memory.instances().size(), 100u);
  memory.keepAround({60.0, 0.0}, 10.0, 11.0, false);
  EXPECT_EQ(memory.instances().size(), 0u) << "put aside";
  memory.keepAround({39.0, 0.0}, 10.0, 11.0, false);
  EXPECT_EQ(memory.instances().size(), 100u) << "taken back as a whole";
  memory.keepAround({60.0, 0.0}, 10.0, 11.0, true);
  memory.keepAround({0.0, 0.0}, 10.0, 11.0, true);
  EXPECT_EQ(memory.instances().size(), 0u) << "forgotten";
}

/// Plays the walk into a window on disk; the function is called at its far end.
void walkWith(const std::string& folder, const std::function<void(SemanticMap*)>& atFarEnd,
              const std::function<void(SemanticMap*)>& atEnd) {
  SemanticMap window{makeParams(8.0, "disk", folder)};
  for (size_t k = 0; k < walk().size(); ++k) {
    if (k == countOut()) atFarEnd(&window);
    window.update(walk()[k], makeRules(1.0));
  }
  atEnd(&window);
}

TEST(RollingWindow, spoilt_files_make_their_ground_unknown_and_are_told) {
  const std::vector<std::function<void(const std::string&)>> spoilers{
      [](const std::string& path) { ::unlink(path.c_str()); },
      [](const std::string& path) { EXPECT_EQ(::truncate(path.c_str(), 5000), 0); },
      [](const std::string& path) { EXPECT_EQ(::truncate(path.c_str(), 0), 0); },
      [](const std::string& path) {
        std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
        file.seekp(700);
        file.put(77);
      }};
  for (const auto& spoil : spoilers) {
    const Folder folder;
    const auto atFarEnd = [&](SemanticMap* map) {
      EXPECT_TRUE(waitFor([map] { return map->windowStatus().away.unwritten == 0; }));
      EXPECT_GE(folder.tiles().size(), 2u);
      for (const std::string& path : folder.tiles()) spoil(path);
    };
    walkWith(folder.path, atFarEnd, [](SemanticMap* map) {
      EXPECT_EQ(stateAt(map->grid(), -0.1, 0.1), CellState::kUnknown);
      EXPECT_GE(map->windowStatus().away.lost, 2u);
      EXPECT_NE(map->windowStatus().away.read_error, "");
    });
  }
}

TEST(RollingWindow, tiles_stay_in_memory_while_the_disk_refuses_them) {
  const Folder folder;
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, SIG_IGN);
  SemanticMap whole{makeParams(0.0, "drop", "")};
  for (const Frame& frame : walk()) whole.update(frame, makeRules(1.0));
  rlimit full = before;
  full.rlim_cur = 100;
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &full), 0);
  std::string error;
  size_t n_unwritten = 0, n_files = 99;
  const auto atFarEnd = [&](SemanticMap* map) {
    waitFor([map] { return !map->windowStatus().away.write_error.empty(); });
    error = map->windowStatus().away.write_error;
    n_unwritten = map->windowStatus().away.unwritten;
    n_files = folder.tiles().size();
  };
  walkWith(folder.path, atFarEnd, [&](SemanticMap* map) {
    ::setrlimit(RLIMIT_FSIZE, &before);
    expectSameGrid(map->grid(), whole.grid(), "end");
    EXPECT_EQ(map->windowStatus().away.lost, 0u);
  });
  EXPECT_NE(error.find("File too large"), std::string::npos) << error;
  EXPECT_GE(n_unwritten, 3u);
  EXPECT_LE(n_files, 1u) << "but for the one being tried";
}

TEST(RollingWindow, files_go_with_the_map_and_those_of_dead_runs_with_the_next) {
  const Folder folder;
  const std::string dead = folder.path + "/core_tiles_dead01";
  ::mkdir(dead.c_str(), 0755);
  std::ofstream(dead + "/lock").put('x');
  std::ofstream(dead + "/7.tile").put('x');
  {
    SemanticMap window{makeParams(8.0, "disk", folder.path)};
    const SemanticMap second{makeParams(8.0, "disk", folder.path)};
    EXPECT_EQ(listFolder(folder.path).size(), 2u) << "each has its own, the dead run none";
    for (size_t k = 0; k < countOut(); ++k) window.update(walk()[k], makeRules(1.0));
    EXPECT_TRUE(waitFor([&] { return folder.tiles().size() >= 3; }));
    window.clear();
    EXPECT_EQ(window.windowStatus().away.tiles, 0u);
    EXPECT_TRUE(waitFor([&] { return folder.tiles().empty(); }));
  }
  EXPECT_EQ(listFolder(folder.path).size(), 0u);
}

TEST(RollingWindow, box_clears_what_is_away_too) {
  const Folder folder;
  const double inf = std::numeric_limits<double>::infinity();
  const auto atFarEnd = [&](SemanticMap* map) {
    const size_t n = map->windowStatus().away.tiles;
    EXPECT_FALSE(map->clearBox({0.0, 100.0, -1.0}, {5.0, 101.0, 1.0}));
    EXPECT_EQ(map->windowStatus().away.tiles, n);
    EXPECT_TRUE(map->clearBox({3.0, -1.0, -inf}, {4.0, 1.0, inf}));
    EXPECT_LT(map->windowStatus().away.tiles, n);
    EXPECT_EQ(map->history_start_s(), 0.0);
  };
  walkWith(folder.path, atFarEnd, [](SemanticMap*) {});
}

TEST(RollingWindow, square_cleared_while_away_is_not_taken_for_the_first_disc) {
  const Folder folder;
  SemanticMapParams params;
  params.window_m = params.window.keep_radius_m = 10.0;
  params.window.outside = "disk";
  params.window.tile_dir = folder.path;
  SemanticMap map{params};
  Scene scene;
  scene.cylinders = {{"cone", {1.2, 0.3}, 0.15, 0.0, 0.7}};
  const Constraints rules = makeConeRules();
  double stamp_s = 1.0;
  const auto look = [&](double x_m, double yaw_rad) {
    map.update(scene.render(stamp_s += 0.1, x_m, 0.0, yaw_rad), rules);
  };
  look(0.0, 0.0);
  for (int k = 0; k < 10; ++k) look(-0.5, 0.0);
  for (double x_m = 0.0; x_m > -60.0; x_m -= 0.5) look(x_m, M_PI);
  ASSERT_TRUE(map.clearBox({5.0, 5.0, -1.0}, {5.2, 5.2, 2.0})) << "of the cone's square";
  for (double x_m = -60.0; x_m < -0.4; x_m += 0.5) look(x_m, M_PI);
  const GridFrame& frame = map.grid().frame;
  const int x = static_cast<int>(std::floor(1.15 / frame.resolution_m)) - frame.origin.x;
  const int y = static_cast<int>(std::floor(0.3 / frame.resolution_m)) - frame.origin.y;
  EXPECT_NE(map.grid().state[static_cast<size_t>(y) * frame.width + x], CellState::kSafe);
}

TEST(RollingWindow, folder_that_cannot_be_written_to_is_refused) {
  try {
    SemanticMap map{makeParams(8.0, "disk", "/no/such/folder")};
    FAIL();
  } catch (const ParameterError& error) {
    EXPECT_EQ(std::string(error.what()).find("map_dir: got /no/such/folder, allowed "), 0u);
  }
}

/// A robot carried elsewhere, as when it is localised anew: all that is needed is there at once.
TEST(RollingWindow, jump_brings_ground_back_at_once) {
  const Folder folder;
  SemanticMap whole{makeParams(0.0, "drop", "")};
  SemanticMap window{makeParams(8.0, "disk", folder.path)};
  for (size_t k = 0; k < countOut(); ++k) {
    whole.update(walk()[k], makeRules(1.0));
    window.update(walk()[k], makeRules(1.0));
  }
  ASSERT_TRUE(waitFor([&] { return window.windowStatus().away.unwritten == 0; }));
  Frame start = walk()[4];
  start.stamp_s += 100.0;
  expectSameGrid(window.update(start, makeRules(1.0)), whole.update(start, makeRules(1.0)), "jump");
}

TEST(VoteMap, tile_taken_out_leaves_the_rest_and_put_back_restores_all) {
  std::mt19937 random(7);
  std::uniform_int_distribution<int> x(-70, 70), z(-5, 14), n(0, 5);
  SemanticOcTree saved(0.2);
  for (int i = 0; i < 20000; ++i) {
    const auto key = [&](int index) {
      return static_cast<octomap::key_type>(index + SemanticOcTree::kKeyOffset);
    };
    saved.touch({key(x(random)), key(x(random)), key(z(random))})
        ->setCounts(n(random), 1 + n(random));
  }
  VoteMap map(0.2, RangeParams(), VoteParams());
  map.load(saved, true, 3);
  SnapshotTaker taker;
  const TreeSnapshot before = taker.take(&map.tree());
  for (const CellIndex& tile : map.listTiles()) {
    MapTile content = map.takeTile(tile);
    ASSERT_FALSE(content.voxels.empty());
    for (const MapTile::Voxel& voxel : content.voxels) {
      ASSERT_EQ(std::floor(voxel.index.x / 32.0), tile.x);
      ASSERT_TRUE(map.counts(voxel.index).empty());
      ASSERT_EQ(map.find(voxel.index.x, voxel.index.y), nullptr);
    }
    EXPECT_EQ(map.tree().size(), map.tree().calcNumNodes());
    EXPECT_EQ(taker.take(&map.tree()).nodes, takeSnapshot(map.tree()).nodes) << "changes are noted";
    map.putTile(tile, std::move(content));
    EXPECT_EQ(taker.take(&map.tree()).nodes, before.nodes);
  }
  std::vector<CellIndex> tiles = map.listTiles();
  EXPECT_EQ(tiles.size(), 36u);
  for (const CellIndex& tile : tiles) map.takeTile(tile);
  EXPECT_EQ(map.tree().size(), 0u);
  EXPECT_TRUE(map.listTiles().empty());
}

/// Who keeps copies of blocks must hear that they went.
TEST(SemanticOcTree, cube_that_is_erased_is_told_as_changed_and_nothing_else_goes) {
  SemanticOcTree tree(0.2);
  const auto key = [](int x, int y, int z) {
    const auto at = [](int i) { return static_cast<octomap::key_type>(i + (1 << 15)); };
    return octomap::OcTreeKey(at(x), at(y), at(z));
  };
  for (int x = 0; x < 40; x += 8) {
    for (int z = -8; z < 24; z += 8) tree.touch(key(x, 3, z))->setCounts(1, 2);
  }
  const size_t before = tree.size();
  tree.takeChanges();
  tree.eraseCube(key(5, 5, 500), 11);
  EXPECT_EQ(tree.size(), before) << "there was nothing";
  tree.eraseCube(key(5, 5, 5), 11);
  const SemanticOcTree::Changes changes = tree.takeChanges();
  EXPECT_FALSE(changes.everywhere);
  for (int x = 0; x < 40; x += 8) {
    for (int z = -8; z < 24; z += 8) {
      const bool inside = x < 32 && z >= 0;
      EXPECT_EQ(tree.find(key(x, 3, z)) == nullptr, inside) << x << " " << z;
      EXPECT_EQ(changes.blocks.count(SemanticOcTree::blockOf(key(x, 3, z))), inside ? 1u : 0u);
    }
  }
  EXPECT_EQ(tree.size(), tree.calcNumNodes());
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
