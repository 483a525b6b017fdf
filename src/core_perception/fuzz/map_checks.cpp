// SPDX-License-Identifier: BSD-3-Clause
#include "map_checks.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <set>
#include <vector>

#include "core_perception/ros/conversions.h"

namespace core_perception {
namespace fuzz {
namespace {

/// FNV-1a.
class Digest {
 public:
  void add(const void* data, size_t size) {
    const auto* bytes = static_cast<const uint8_t*>(data);
    for (size_t i = 0; i < size; ++i) hash_ = (hash_ ^ bytes[i]) * 1099511628211ull;
  }
  template <typename T>
  void addValue(const T& value) {
    add(&value, sizeof(value));
  }
  template <typename T>
  void addAll(const std::vector<T>& values) {
    addValue(values.size());
    if (!values.empty()) add(values.data(), values.size() * sizeof(T));
  }
  void addText(const std::string& text) {
    addValue(text.size());
    add(text.data(), text.size());
  }
  uint64_t value() const { return hash_; }

 private:
  uint64_t hash_ = 14695981039346656037ull;
};

void addGrid(const SafetyGrid& grid, Digest* digest) {
  digest->addValue(grid.frame.origin.x);
  digest->addValue(grid.frame.origin.y);
  digest->addAll(grid.n_safe);
  digest->addAll(grid.n_unsafe);
  digest->addAll(grid.state);
  digest->addAll(grid.h_m);
  digest->addAll(grid.cause);
  digest->addAll(grid.speed_cap_mps);
  for (const Cause& cause : grid.causes) {
    digest->addText(cause.rule);
    digest->addText(cause.class_name);
    digest->addValue(cause.instance_id);
  }
}

void addInstances(const std::vector<HeldInstance>& instances, Digest* digest) {
  for (const HeldInstance& held : instances) {
    digest->addText(held.class_name);
    digest->addAll(held.footprint);
    digest->addAll(held.cells);
    for (const uint32_t number : {held.id, held.cluster, held.frames_seen})
      digest->addValue(number);
    for (const double number : {held.z_min_m, held.z_max_m, held.last_seen_s, held.largest_view_m})
      digest->addValue(number);
    digest->addValue(held.doubt);
    digest->addValue(held.in_view);
    digest->addValue(held.confirmed);
  }
}

void addPredicates(const std::vector<Predicate>& predicates, Digest* digest) {
  for (const Predicate& predicate : predicates) {
    digest->addText(formatRule(predicate));
    digest->addValue(predicate.verdict);
    digest->addValue(predicate.severity);
    digest->addValue(predicate.radius_m);
    for (const uint32_t number : predicate.exempt_instances) digest->addValue(number);
  }
}

void checkSizes(const SafetyGrid& grid) {
  const auto n = static_cast<size_t>(grid.frame.width) * static_cast<size_t>(grid.frame.height);
  require(n > 0 && grid.n_safe.size() == n && grid.n_unsafe.size() == n && grid.state.size() == n &&
              grid.h_m.size() == n && grid.cause.size() == n,
          "every array of the grid has one value a cell");
  require(grid.speed_cap_mps.empty() || grid.speed_cap_mps.size() == n,
          "speed caps are none or one a cell");
  require(grid.causes.size() <= kNoCause, "causes can be numbered");
}

void checkCell(const SafetyGrid& grid, size_t i, const SemanticMapParams& params) {
  require(grid.state[i] == CellState::kSafe || grid.state[i] == CellState::kUnsafe ||
              grid.state[i] == CellState::kUnknown,
          "a state is one of three");
  require(grid.cause[i] == kNoCause || grid.cause[i] < grid.causes.size(),
          "a cause is in the list of causes");
  const double diagonal_m = std::hypot(grid.frame.width, grid.frame.height) * params.resolution_m;
  require(std::isfinite(grid.h_m[i]), "h is finite");
  require(std::abs(grid.h_m[i]) <= diagonal_m * (1.0 + 1e-6), "h is within the grid's diagonal");
  const bool unsafe = grid.state[i] == CellState::kUnsafe ||
                      (grid.state[i] == CellState::kUnknown && grid.unknown_is_unsafe);
  require(unsafe ? grid.h_m[i] < 0.0f : grid.h_m[i] > 0.0f,
          "the sign of h is that of the decision");
  const bool unknown = grid.n_safe[i] == 0 && grid.n_unsafe[i] == 0;
  require(grid.state[i] != CellState::kSafe || !unknown, "nothing is safe without a vote");
  if (!grid.speed_cap_mps.empty() && !std::isnan(grid.speed_cap_mps[i]))
    require(grid.speed_cap_mps[i] == static_cast<float>(params.slow_speed_mps),
            "a speed cap is the parameter's");
}

void checkInstances(const SemanticMap& map) {
  std::set<uint32_t> ids;
  for (const HeldInstance& held : map.instances()) {
    require(held.id > 0 && ids.insert(held.id).second, "an object has a number of its own");
    require(!held.footprint.empty() && !held.cells.empty(), "an object lies somewhere");
    require(held.footprint.size() <= 100000, "a footprint is bounded");
    require(std::all_of(held.footprint.begin(), held.footprint.end(),
                        [](const Point2& p) { return std::isfinite(p.x) && std::isfinite(p.y); }),
            "a footprint is finite");
    require(std::is_sorted(held.cells.begin(), held.cells.end()), "cells are sorted");
    require(held.z_min_m <= held.z_max_m, "an object has a lower and an upper end");
    require(held.frames_seen > 0, "an object was seen");
  }
  for (const HeldInstance& held : map.instances())
    require(ids.count(held.cluster) == 1, "a cluster has the number of one of its objects");
}

void checkTree(SemanticMap* map) {
  const auto cap = static_cast<uint64_t>(map->params().vote.count_cap);
  SemanticOcTree& tree = map->votes().tree();
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    const uint64_t total = static_cast<uint64_t>(leaf->n_safe()) + leaf->n_unsafe();
    require(total > 0, "a leaf has votes");
    require(map->params().vote.votes != "frame" || cap == 0 || total <= cap, "votes are capped");
    require(std::isfinite(leaf->getValue()), "the value of a leaf is finite");
  }
}

void checkMessages(SemanticMap* map) {
  std_msgs::Header header;
  const core_msgs::SafetyGrid grid = safetyGridToMessage(map->grid(), header, ros::Time());
  const size_t n = static_cast<size_t>(grid.width) * grid.height;
  require(grid.h_m.size() == n && grid.state.size() == n && grid.cause.size() == n,
          "the message has one value a cell");
  instancesToMessage(map->instances(), map->predicates(), header);
  for (const auto& message :
       {probabilityToMessage(map->grid(), header), decisionToMessage(map->grid(), header)}) {
    require(message.data.size() == n, "an occupancy grid has one value a cell");
    require(std::all_of(message.data.begin(), message.data.end(),
                        [](int8_t value) { return value >= -1 && value <= 100; }),
            "an occupancy grid holds -1 to 100");
  }
  for (const WireFormat format :
       {WireFormat::kFull, WireFormat::kBinary, WireFormat::kColor, WireFormat::kSemantic})
    octomapToMessage(format, header, takeSnapshot(map->votes().tree()));
}

}  // namespace

uint64_t computeDigest(SemanticMap* map) {
  Digest digest;
  addGrid(map->grid(), &digest);
  SemanticOcTree& tree = map->votes().tree();
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    for (int axis = 0; axis < 3; ++axis) digest.addValue(leaf.getKey()[axis]);
    digest.addValue(leaf.getDepth());
    digest.addValue(leaf->n_safe());
    digest.addValue(leaf->n_unsafe());
  }
  addInstances(map->instances(), &digest);
  addPredicates(map->predicates(), &digest);
  digest.addValue(map->history_start_s());
  digest.addValue(map->votes().version());
  return digest.value();
}

void checkMap(SemanticMap* map) {
  const SafetyGrid& grid = map->grid();
  checkSizes(grid);
  for (size_t i = 0; i < grid.state.size(); ++i) checkCell(grid, i, map->params());
  checkInstances(*map);
  checkTree(map);
  checkMessages(map);
}

void checkDiagnostic(const FrameError& error) {
  const std::string& reason = error.reason();
  require(!reason.empty() && std::all_of(reason.begin(), reason.end(),
                                         [](char c) { return c == '_' || std::islower(c) != 0; }),
          "a reason is in lower snake case");
  const std::string text = error.what();
  constexpr size_t kLongest = 500;
  require(text.size() <= kLongest, "a diagnostic is short");
  require(std::all_of(text.begin(), text.end(), [](char c) { return c >= 32 && c < 127; }),
          "a diagnostic is one line of printable text");
}

}  // namespace fuzz
}  // namespace core_perception
