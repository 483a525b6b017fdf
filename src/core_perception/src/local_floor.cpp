// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/local_floor.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace core_perception {
namespace {

constexpr float kInfinite = std::numeric_limits<float>::infinity();
constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
constexpr float kTight_m = 0.01f;
constexpr float kFlat_m = 0.07f;  // a ramp of kGrade across a column, and noise
constexpr int kHop = 2;           // columns; floor this near bounds a column

int floorDivide(double value, double step) { return static_cast<int>(std::floor(value / step)); }

}  // namespace

constexpr double LocalFloor::kCell_m;
constexpr float LocalFloor::kGrade;
constexpr float LocalFloor::kNoise;
constexpr float LocalFloor::kLowering_m;
constexpr float LocalFloor::kHeldReach_m;
constexpr float LocalFloor::kRisePerFrame_m;
constexpr float LocalFloor::kDriftPerFrame_m;

LocalFloor::LocalFloor(const RangeParams& range, double initial_disc_radius_m)
    : radius_m_(initial_disc_radius_m),
      step_m_(0.9f * static_cast<float>(range.metric_min_height_m)),
      samples_(kCell_m, range, kGrade) {}

int LocalFloor::indexOf(double x_m, double y_m) const {
  const auto clamp = [this](int i) { return std::min(std::max(i, 0), width_ - 1); };
  return clamp(floorDivide(y_m, kCell_m) - origin_.y) * width_ +
         clamp(floorDivide(x_m, kCell_m) - origin_.x);
}

float LocalFloor::height_m(double x_m, double y_m) const {
  return height_.empty() ? 0.0f : height_[indexOf(x_m, y_m)];
}

FloorState LocalFloor::state(double x_m, double y_m) const {
  return state_.empty() ? FloorState::kAssumed : state_[indexOf(x_m, y_m)];
}

void LocalFloor::level(PointRow* row) const {
  constexpr auto kCellsPerMetre = static_cast<float>(1.0 / kCell_m);
  columns_.resize(row->depth_m.size());
  int32_t* columns = columns_.data();
  const float *dx = row->dx_m.data(), *dy = row->dy_m.data();
  const float x0 = camera_x_, y0 = camera_y_;
  const int width = width_, last = width_ * width_ - 1;
  for (int u = row->first, end = row->end; u < end; ++u) {
    // Within reach neither is negative, so that the conversion is floor().
    const int x = static_cast<int>(x0 + dx[u] * kCellsPerMetre);
    const int y = static_cast<int>(y0 + dy[u] * kCellsPerMetre);
    columns[u] = std::min(std::max(y * width + x, 0), last);
  }
  float* dz = row->dz_m.data();
  const float* heights = height_.data();
  for (int u = row->first, end = row->end; u < end; ++u) dz[u] -= heights[columns[u]];
}

void LocalFloor::clear() {
  width_ = 0;
  has_disc_ = false;
  for (std::vector<float>* values : {&held_, &floor_, &height_}) values->clear();
  state_.clear();
}

void LocalFloor::update(const cv::Mat& metres, const Projection& projection,
                        const Point2& p_map_base) {
  moveWindow(projection, p_map_base);
  const Eigen::Vector3d& camera = projection.p_map_camera();
  camera_x_ = static_cast<float>(camera.x() / kCell_m - origin_.x);
  camera_y_ = static_cast<float>(camera.y() / kCell_m - origin_.y);
  samples_.collect(metres, projection, origin_, width_, floor_[order_[0]]);
  grow();
  lower();
  followDrift(projection);
}

void LocalFloor::moveWindow(const Projection& projection, const Point2& p_map_base) {
  const int reach = static_cast<int>(std::ceil(projection.reach_m() / kCell_m)) + 1;
  const CellIndex origin{floorDivide(projection.p_map_camera().x(), kCell_m) - reach,
                         floorDivide(projection.p_map_camera().y(), kCell_m) - reach};
  const int width = 2 * reach + 1;
  if (width != width_ || !(origin == origin_)) {
    std::vector<float> held(static_cast<size_t>(width) * width, kNothing);
    const int x0 = std::max(origin.x, origin_.x);
    const int x1 = std::min(origin.x + width, origin_.x + width_);
    const int y1 = std::min(origin.y + width, origin_.y + width_);
    for (int y = std::max(origin.y, origin_.y); y < y1 && x0 < x1; ++y) {
      const float* from = &held_[static_cast<size_t>(y - origin_.y) * width_ + (x0 - origin_.x)];
      std::copy(from, from + (x1 - x0),
                &held[static_cast<size_t>(y - origin.y) * width + (x0 - origin.x)]);
    }
    held_ = std::move(held);
    anchor_.clear();
    origin_ = origin;
    if (width != width_) layOut(reach);
  }
  if (!has_disc_) holdDisc(p_map_base, projection.camera_height_m());
  has_disc_ = true;
}

void LocalFloor::layOut(int reach) {
  width_ = 2 * reach + 1;
  const size_t n = static_cast<size_t>(width_) * width_;
  for (std::vector<float>* values : {&floor_, &level_, &height_, &range_m_})
    values->assign(n, 0.0f);
  state_.assign(n, FloorState::kAssumed);
  is_ground_.assign(n, 0);
  inner_.resize(n);
  for (size_t i = 0; i < n; ++i) {
    const int dx = static_cast<int>(i) % width_ - reach, dy = static_cast<int>(i) / width_ - reach;
    const double distance = std::hypot(dx, dy);
    range_m_[i] = static_cast<float>(distance * kCell_m);
    const auto towards = [distance](int d) {
      return distance > 0.0 ? d - static_cast<int>(std::lround(d / distance)) : 0;
    };
    inner_[i] = (towards(dy) + reach) * width_ + towards(dx) + reach;
  }
  order_.resize(n);
  std::iota(order_.begin(), order_.end(), 0);
  std::stable_sort(order_.begin(), order_.end(),
                   [this](int a, int b) { return range_m_[a] < range_m_[b]; });
  near_.clear();
  for (int dy = -kHop; dy <= kHop; ++dy) {
    for (int dx = -kHop; dx <= kHop; ++dx) {
      if (dx == 0 && dy == 0) continue;
      const auto slope_m = static_cast<float>(kGrade * kCell_m * std::hypot(dx, dy));
      const bool adjacent = std::max(std::abs(dx), std::abs(dy)) == 1;
      near_.push_back({dy * width_ + dx, std::max(step_m_, slope_m), slope_m + kTight_m, adjacent});
    }
  }
}

void LocalFloor::holdDisc(const Point2& p_map_base, float camera_height_m) {
  if (std::isnan(first_height_m_)) first_height_m_ = camera_height_m;
  const float floor_m = camera_height_m - first_height_m_;
  for (int cell = 0; cell < width_ * width_; ++cell) {
    const double x_m = (origin_.x + cell % width_ + 0.5) * kCell_m;
    const double y_m = (origin_.y + cell / width_ + 0.5) * kCell_m;
    if (std::hypot(x_m - p_map_base.x, y_m - p_map_base.y) <= radius_m_) held_[cell] = floor_m;
  }
}

void LocalFloor::grow() {
  std::fill(is_ground_.begin(), is_ground_.end(), 0);
  const auto root = std::find_if(order_.begin(), order_.end(),
                                 [this](int cell) { return std::isfinite(held_[cell]); });
  level_[order_[0]] = root == order_.end() ? 0.0f : held_[*root];
  for (const int cell : order_) growColumn(cell, range_m_[cell]);
}

void LocalFloor::growColumn(int cell, float range_m) {
  const ColumnSamples& seen = samples_[cell];
  const float held_m = range_m <= kHeldReach_m ? held_[cell] : kNothing;
  floor_[cell] = level_[cell] = level_[inner_[cell]];
  state_[cell] = FloorState::kAssumed;
  const int x = cell % width_, y = cell / width_;
  const bool is_inside = std::min(x, y) >= kHop && std::max(x, y) < width_ - kHop;
  if (!is_inside || (!seen.isSeen() && std::isnan(held_m))) return;

  const Bounds bounds = findBounds(cell);
  const float noise_m = kNoise * range_m;
  const bool agrees = bounds.holds(held_m, noise_m);  // false for NaN
  // What stands in a column may hide the lowest part of its own foot.
  const bool is_flat = seen.highest - seen.third <= kFlat_m + noise_m;
  if (seen.isSeen() && (is_flat ? bounds : bounds.tighten()).holds(seen.third, noise_m)) {
    state_[cell] = FloorState::kSeen;
    held_[cell] = agrees ? std::min(seen.third, held_m + kRisePerFrame_m) : seen.third;
    join(cell, held_[cell], bounds);
  } else if (seen.isSeen()) {
    state_[cell] = seen.third > bounds.high_m ? FloorState::kRaised : FloorState::kDrop;
    // What hides the floor now may have been taken for it before.
    if (agrees) floor_[cell] = std::min(floor_[cell], held_m);
    if (!agrees) held_[cell] = kNothing;
  } else if (agrees) {
    state_[cell] = FloorState::kHeld;
    join(cell, held_m, bounds);
  }
}

LocalFloor::Bounds LocalFloor::findBounds(int cell) const {
  Bounds bounds;
  bool is_beside = false;
  for (const Neighbour& near : near_) {
    const int other = cell + near.offset;
    if (is_ground_[other] == 0) continue;
    bounds.add(floor_[other], near.step_m, near.tight_m);
    is_beside |= near.adjacent;
    if (near.adjacent) bounds.lowest_m = std::min(bounds.lowest_m, floor_[other]);
  }
  if (is_beside) return bounds;
  // Nothing but assumed floor: it goes on level.
  bounds = Bounds();
  bounds.lowest_m = floor_[cell];
  bounds.add(floor_[cell], step_m_, kTight_m);
  return bounds;
}

void LocalFloor::join(int cell, float z_m, const Bounds& bounds) {
  is_ground_[cell] = 1;
  floor_[cell] = z_m;
  level_[cell] = std::min(z_m, bounds.lowest_m);
}

void LocalFloor::lower() {
  height_ = floor_;
  const auto take = [this](int cell, int other) {
    if (is_ground_[other] != 0) height_[cell] = std::min(height_[cell], floor_[other]);
  };
  const int radius = static_cast<int>(std::ceil(kLowering_m / kCell_m));
  for (int y = kHop; y < width_ - kHop; ++y) {
    for (int x = kHop; x < width_ - kHop; ++x) {
      const int cell = y * width_ + x;
      if (samples_[cell].first == kInfinite) continue;  // no point lies here
      for (const int offset : {-width_, -1, 1, width_}) take(cell, cell + offset);
      if (state_[cell] != FloorState::kRaised) continue;
      for (int j = std::max(0, y - radius); j <= std::min(width_ - 1, y + radius); ++j) {
        for (int i = std::max(0, x - radius); i <= std::min(width_ - 1, x + radius); ++i)
          take(cell, j * width_ + i);
      }
    }
  }
}

void LocalFloor::followDrift(const Projection& projection) {
  const Eigen::Vector3d moved = projection.p_map_camera() - p_last_camera_;
  p_last_camera_ = projection.p_map_camera();
  // While it walks, an error of pitch looks like a drift; but then nothing is held for long.
  constexpr double kStanding_m = 0.01;
  if (std::hypot(moved.x(), moved.y()) > kStanding_m || anchor_.size() != held_.size()) {
    anchor_ = held_;
    followed_m_ = 0.0f;
    return;
  }
  const float change_m = measureChange(projection) - followed_m_;
  const float shift_m = std::min(std::max(change_m, -kDriftPerFrame_m), kDriftPerFrame_m);
  followed_m_ += shift_m;
  for (size_t cell = 0; cell < held_.size(); ++cell) {
    if (state_[cell] != FloorState::kSeen) held_[cell] += shift_m;  // NaN stays NaN
  }
}

float LocalFloor::measureChange(const Projection& projection) {
  constexpr float kNear_m = 4.0f;
  constexpr size_t kFewest = 10;
  const Camera& camera = projection.camera();
  for (std::vector<float>& changes_m : changes_m_) changes_m.clear();
  for (const int cell : order_) {
    if (range_m_[cell] > kNear_m) break;
    if (state_[cell] != FloorState::kSeen || !std::isfinite(anchor_[cell])) continue;
    const Eigen::Vector3d p((origin_.x + cell % width_ + 0.5) * kCell_m,
                            (origin_.y + cell / width_ + 0.5) * kCell_m,
                            projection.p_map_camera().z());
    const double part = projection.project(p).x() / camera.width_px;
    const int third = std::min(std::max(static_cast<int>(3.0 * part), 0), 2);
    changes_m_[third].push_back(held_[cell] - anchor_[cell]);
  }
  // What drifts takes the whole view along; what rises does not.
  float least_m = kInfinite, most_m = -kInfinite;
  for (std::vector<float>& changes_m : changes_m_) {
    if (changes_m.size() < kFewest) return followed_m_;
    const auto middle = changes_m.begin() + static_cast<std::ptrdiff_t>(changes_m.size() / 2);
    std::nth_element(changes_m.begin(), middle, changes_m.end());
    least_m = std::min(least_m, *middle);
    most_m = std::max(most_m, *middle);
  }
  return least_m > 0.0f ? least_m : std::min(most_m, 0.0f);
}

}  // namespace core_perception
