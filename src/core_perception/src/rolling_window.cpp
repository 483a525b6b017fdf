// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/rolling_window.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <set>
#include <string>
#include <type_traits>

namespace core_perception {
namespace {

constexpr double kSlackTiles = 1.0;
constexpr double kReadAheadTiles = 0.5;
constexpr double kPlanEvery_m = 1.0;  // of the robot's way
constexpr int kVoxelsAFrame = 4000;   // some 0.5 ms

template <typename Value>
void append(const Value& value, std::string* bytes) {
  static_assert(std::is_trivially_copyable<Value>::value, "copied byte by byte");
  bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
}

template <typename Value>
void extract(const char** at, Value* value) {
  std::memcpy(value, *at, sizeof(*value));
  *at += sizeof(*value);
}

bool isBlank(const Column& column) {
  const Column blank;
  return column.counts.empty() && std::memcmp(&column, &blank, sizeof(blank)) == 0;
}

/// Number of voxels, each voxel, whether there are columns; of these index, column and voxels of
/// the band where anything is known. Of this process alone: numbers of causes and frames mean
/// nothing to another one.
std::string encode(const MapTile& tile, int band_layers) {
  std::string bytes;
  append(static_cast<uint32_t>(tile.voxels.size()), &bytes);
  for (const MapTile::Voxel& voxel : tile.voxels) append(voxel, &bytes);
  append(static_cast<uint8_t>(!tile.columns.empty()), &bytes);
  for (size_t i = 0; i < tile.columns.size(); ++i) {
    if (isBlank(tile.columns[i])) continue;
    append(static_cast<uint16_t>(i), &bytes);
    append(tile.columns[i], &bytes);
    for (int k = 0; k < band_layers; ++k) append(tile.band[k * tile.columns.size() + i], &bytes);
  }
  return bytes;
}

MapTile decode(const std::string& bytes, int band_layers) {
  MapTile tile;
  const char* at = bytes.data();
  uint32_t n_voxels = 0;
  extract(&at, &n_voxels);
  tile.voxels.resize(n_voxels);
  for (MapTile::Voxel& voxel : tile.voxels) extract(&at, &voxel);
  uint8_t has_columns = 0;
  extract(&at, &has_columns);
  if (has_columns == 0) return tile;
  tile.columns.resize(VoteMap::kTile * VoteMap::kTile);
  tile.band.resize(tile.columns.size() * band_layers);
  while (at < bytes.data() + bytes.size()) {
    uint16_t i = 0;
    extract(&at, &i);
    extract(&at, &tile.columns[i]);
    for (int k = 0; k < band_layers; ++k) extract(&at, &tile.band[k * tile.columns.size() + i]);
  }
  return tile;
}

}  // namespace

RollingWindow::RollingWindow(const SemanticMapParams& params)
    : params_(params.window),
      tile_m_(VoteMap::kTile * params.resolution_m),
      // Half of its diagonal, and the steps in which it follows the robot.
      published_m_(0.71 * params.window_m + 5.0 * params.resolution_m),
      gap_m_(params.instance.between_max_gap_m) {
  if (params_.outside == "disk") store_ = std::make_unique<TileStore>(params_.tile_dir);
}

/// From the robot to the nearest point of a tile [m].
double RollingWindow::distanceTo(const CellIndex& tile, const Point2& robot) const {
  return computeDistance(robot, Box2{tile.x * tile_m_, tile.y * tile_m_, (tile.x + 1) * tile_m_,
                                     (tile.y + 1) * tile_m_});
}

bool RollingWindow::follow(const Point2& robot, double reach_m, double region_radius_m,
                           VoteMap* votes, InstanceMemory* memory) {
  // What this frame adds to, takes from or publishes.
  const double needed_m = std::max(reach_m, published_m_);
  const double radius_m = std::max(params_.keep_radius_m, needed_m + kPlanEvery_m);
  const double moved_m = std::hypot(robot.x - planned_at_.x, robot.y - planned_at_.y);
  const bool due = !planned_ || moved_m >= kPlanEvery_m || radius_m > planned_radius_m_;
  if (due) plan(robot, radius_m, *votes);
  budget_ = kVoxelsAFrame;
  bool forgotten = bringBack(robot, needed_m, votes);
  while (budget_ > 0 && !leaving_.empty()) forgotten = sendAway(votes) || forgotten;
  if (due) {
    // Beyond what is in memory, up to the next plan: no region of theirs covers any of it.
    const double ground_m = radius_m + (kSlackTiles + std::sqrt(2.0)) * tile_m_ + kPlanEvery_m;
    const double return_m = ground_m + std::max(region_radius_m, gap_m_);
    memory->keepAround(robot, return_m, return_m + kPlanEvery_m, store_ == nullptr);
  }
  return forgotten;
}

void RollingWindow::plan(const Point2& robot, double radius_m, const VoteMap& votes) {
  planned_ = true;
  planned_at_ = robot;
  planned_radius_m_ = radius_m;
  const auto nearest_last = [&](const CellIndex& a, const CellIndex& b) {
    return distanceTo(a, robot) > distanceTo(b, robot);
  };
  leaving_.clear();
  const std::vector<CellIndex> in_memory = votes.listTiles();
  n_in_memory_ = in_memory.size();
  for (const CellIndex& tile : in_memory) {
    if (distanceTo(tile, robot) > radius_m + kSlackTiles * tile_m_) leaving_.push_back(tile);
  }
  std::sort(leaving_.begin(), leaving_.end(), nearest_last);
  coming_.clear();
  if (store_ == nullptr) return;
  std::set<CellIndex> passed;
  passed.swap(read_ahead_);
  const int reach = static_cast<int>(std::ceil(radius_m / tile_m_ + kReadAheadTiles));
  const CellIndex own{static_cast<int>(std::floor(robot.x / tile_m_)),
                      static_cast<int>(std::floor(robot.y / tile_m_))};
  for (int x = own.x - reach; x <= own.x + reach; ++x) {
    for (int y = own.y - reach; y <= own.y + reach; ++y) {
      const double distance_m = distanceTo({x, y}, robot);
      if (distance_m > radius_m + kReadAheadTiles * tile_m_ || !store_->has({x, y})) continue;
      read_ahead_.insert({x, y});
      store_->prefetch({x, y});
      if (distance_m <= radius_m) coming_.push_back({x, y});
    }
  }
  for (const CellIndex& tile : passed) {
    if (read_ahead_.count(tile) == 0) store_->release(tile);
  }
  std::sort(coming_.begin(), coming_.end(), nearest_last);
}

/// @returns whether a tile was lost.
bool RollingWindow::bringBack(const Point2& robot, double needed_m, VoteMap* votes) {
  bool lost = false;
  while (!coming_.empty()) {
    const CellIndex tile = coming_.back();
    const bool needed = distanceTo(tile, robot) <= needed_m;
    if (!needed && budget_ <= 0) break;
    TileStore::Bytes bytes;
    const TileStore::Answer answer = store_->take(tile, needed, &bytes);
    if (answer == TileStore::Answer::kPending) break;
    coming_.pop_back();
    lost = lost || answer == TileStore::Answer::kLost;
    if (answer != TileStore::Answer::kReady) continue;
    MapTile content = decode(*bytes, votes->bandLayers());
    budget_ -= static_cast<int>(content.voxels.size());
    votes->putTile(tile, std::move(content));
  }
  return lost;
}

/// @returns whether a tile was dropped.
bool RollingWindow::sendAway(VoteMap* votes) {
  const CellIndex tile = leaving_.back();
  leaving_.pop_back();
  const MapTile content = votes->takeTile(tile);
  budget_ -= static_cast<int>(content.voxels.size());
  if (store_ != nullptr) store_->put(tile, encode(content, votes->bandLayers()));
  return store_ == nullptr;
}

int RollingWindow::clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m) {
  if (store_ == nullptr) return 0;
  int n = 0;
  for (const CellIndex& tile : store_->list()) {
    const bool touched = tile.x * tile_m_ <= max_m.x() && (tile.x + 1) * tile_m_ >= min_m.x() &&
                         tile.y * tile_m_ <= max_m.y() && (tile.y + 1) * tile_m_ >= min_m.y();
    if (!touched) continue;
    store_->forget(tile);
    ++n;
  }
  return n;
}

void RollingWindow::clear() {
  if (store_ != nullptr) store_->clear();
  leaving_.clear();
  coming_.clear();
  read_ahead_.clear();
  planned_ = false;
}

RollingWindow::Status RollingWindow::status() const {
  Status status;
  status.tiles_in_memory = n_in_memory_;
  if (store_ != nullptr) status.away = store_->status();
  return status;
}

}  // namespace core_perception
