// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/safety_grid.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace core_perception {

GridComposer::GridComposer(const SemanticMapParams& params) : params_(params) {
  const int cells = static_cast<int>(std::lround(params.window_m / params.resolution_m));
  grid_.frame.width = grid_.frame.height = std::max(1, cells);
  grid_.frame.resolution_m = params.resolution_m;
  grid_.unknown_is_unsafe = params.unknown_is_unsafe;
}

const SafetyGrid& GridComposer::compose(const VoteMap& votes, const CauseTable& causes,
                                        const InitialDisc& disc, const std::vector<Region>& regions,
                                        const Point2& robot) {
  moveWindow(robot);
  fillFromVotes(votes, causes, disc);
  for (const Region& region : regions) paintRegion(region);
  measure();
  return grid_;
}

void GridComposer::moveWindow(const Point2& robot) {
  // In steps: between them the distances need not be computed again where no cell changed sides.
  constexpr int kStep = 5;
  const auto snap = [this](double robot_m, int size) {
    const double step_m = kStep * params_.resolution_m;
    return static_cast<int>(std::lround(robot_m / step_m)) * kStep - size / 2;
  };
  grid_.frame.origin.x = snap(robot.x, grid_.frame.width);
  grid_.frame.origin.y = snap(robot.y, grid_.frame.height);
  const size_t n = static_cast<size_t>(grid_.frame.width) * grid_.frame.height;
  grid_.n_safe.assign(n, 0);
  grid_.n_unsafe.assign(n, 0);
  grid_.state.assign(n, CellState::kUnknown);
  grid_.cause.assign(n, kNoCause);
  grid_.causes.clear();
  grid_.speed_cap_mps.clear();
}

uint16_t GridComposer::addCause(const Cause& cause) {
  if (grid_.causes.size() >= kNoCause) return kNoCause;
  grid_.causes.push_back(cause);
  return static_cast<uint16_t>(grid_.causes.size() - 1);
}

void GridComposer::fillFromVotes(const VoteMap& votes, const CauseTable& causes,
                                 const InitialDisc& disc) {
  const GridFrame& frame = grid_.frame;
  const uint16_t unknown =
      params_.unknown_is_unsafe ? addCause(Cause{kUnknownRule, "", 0, false}) : kNoCause;
  cause_numbers_.assign(causes.size(), kNoCause);
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0, n = 0; x < frame.width; x += n) {
      n = frame.width - x;
      const Column* columns = votes.findRow(frame.origin.x + x, frame.origin.y + y, &n);
      for (int k = 0; k < n; ++k) {
        const size_t i = static_cast<size_t>(y) * frame.width + x + k;
        if (columns == nullptr || columns[k].counts.empty()) {
          // What was seen once and is forgotten is unknown, not what was assumed at first.
          const bool had_votes = columns != nullptr && columns[k].seen;
          fillUnknown(had_votes ? InitialDisc() : disc, x + k, y, unknown);
          continue;
        }
        const Column& column = columns[k];
        grid_.n_safe[i] = column.counts.n_safe;
        grid_.n_unsafe[i] = column.counts.n_unsafe;
        const bool safe = isSafe(column.counts, params_.vote.tau);
        grid_.state[i] = safe ? CellState::kSafe : CellState::kUnsafe;
        if (safe || column.cause == kNoCause) continue;
        uint16_t& number = cause_numbers_[column.cause];
        if (number == kNoCause) number = addCause(causes.at(column.cause));
        grid_.cause[i] = number;
      }
    }
  }
}

void GridComposer::fillUnknown(const InitialDisc& disc, int x, int y, uint16_t cause) {
  const GridFrame& frame = grid_.frame;
  const size_t i = static_cast<size_t>(y) * frame.width + x;
  const double dx = (frame.origin.x + x + 0.5) * frame.resolution_m - disc.centre.x;
  const double dy = (frame.origin.y + y + 0.5) * frame.resolution_m - disc.centre.y;
  if (dx * dx + dy * dy <= disc.radius_m * disc.radius_m) {
    grid_.n_safe[i] = 1;
    grid_.state[i] = CellState::kSafe;
  } else {
    grid_.cause[i] = cause;
  }
}

void GridComposer::paintRegion(const Region& region) {
  // A region far away has no cell in the window, and its cause no reader.
  bool added = false;
  uint16_t cause = kNoCause;
  const auto find_cause = [&] {
    if (!added) cause = addCause(region.cause);
    added = true;
    return cause;
  };
  if (!region.slow) {
    forEachCell(region, grid_.frame, [&](size_t i) {
      grid_.state[i] = CellState::kUnsafe;
      grid_.cause[i] = find_cause();
    });
    return;
  }
  const float none = std::numeric_limits<float>::quiet_NaN();
  if (grid_.speed_cap_mps.empty()) grid_.speed_cap_mps.assign(grid_.state.size(), none);
  forEachCell(region, grid_.frame, [&](size_t i) {
    grid_.speed_cap_mps[i] = static_cast<float>(params_.slow_speed_mps);
    // What closes a cell is told first.
    if (grid_.cause[i] == kNoCause) grid_.cause[i] = find_cause();
  });
}

void GridComposer::measure() {
  Mask mask;
  mask.width = grid_.frame.width;
  mask.height = grid_.frame.height;
  mask.outside_unsafe = params_.unknown_is_unsafe;
  mask.unsafe.resize(grid_.state.size());
  for (size_t i = 0; i < grid_.state.size(); ++i) {
    const CellState state = grid_.state[i];
    const bool unknown_unsafe = state == CellState::kUnknown && params_.unknown_is_unsafe;
    mask.unsafe[i] = state == CellState::kUnsafe || unknown_unsafe ? 1 : 0;
  }
  if (mask == measured_) return;  // no cell of the window changed sides
  const bool centre = params_.distance == "centre";
  grid_.h_m =
      computeSignedDistance(mask, params_.resolution_m,
                            centre ? DistanceConvention::kCentre : DistanceConvention::kBorder);
  measured_ = std::move(mask);
}

}  // namespace core_perception
