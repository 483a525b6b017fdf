// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include "core_perception/causes.h"
#include "core_perception/ground_regions.h"
#include "core_perception/params.h"
#include "core_perception/signed_distance.h"
#include "core_perception/vote_map.h"

namespace core_perception {

/// Values equal those of core_msgs/SafetyGrid.
enum class CellState : uint8_t { kSafe = 0, kUnsafe = 1, kUnknown = 2 };

/// The decision around the robot; arrays are row-major as core_msgs/SafetyGrid.
struct SafetyGrid {
  GridFrame frame;
  bool unknown_is_unsafe = true;
  std::vector<uint32_t> n_safe, n_unsafe;
  std::vector<CellState> state;
  std::vector<float> h_m;
  std::vector<uint16_t> cause;  ///< index into causes, kNoCause for none
  std::vector<Cause> causes;
  std::vector<float> speed_cap_mps;  ///< empty when no cell has one, NaN where none holds
};

/// Where nothing was ever seen, the disc around the robot's first position is taken as safe.
struct InitialDisc {
  Point2 centre;
  double radius_m = 0.0;
};

/// Puts votes, initial disc and regions together and measures h.
///
///     region of severity STOP over the cell      unsafe, with the region's cause
///     votes                                      safe when n_safe / (n_safe + n_unsafe) >= tau
///     never a vote, centre in the initial disc   safe, shown as one safe vote
///     no votes elsewhere                         unknown
class GridComposer {
 public:
  explicit GridComposer(const SemanticMapParams& params);

  const SafetyGrid& compose(const VoteMap& votes, const CauseTable& causes, const InitialDisc& disc,
                            const std::vector<Region>& regions, const Point2& robot);
  const SafetyGrid& grid() const { return grid_; }

 private:
  void moveWindow(const Point2& robot);
  void fillFromVotes(const VoteMap& votes, const CauseTable& causes, const InitialDisc& disc);
  /// A cell without votes.
  void fillUnknown(const InitialDisc& disc, int x, int y, uint16_t cause);
  void paintRegion(const Region& region);
  void measure();
  uint16_t addCause(const Cause& cause);

  SemanticMapParams params_;
  SafetyGrid grid_;
  std::vector<uint16_t> cause_numbers_;  ///< of the vote map's causes in grid_.causes
  Mask measured_;                        ///< what h_m was computed for
};

}  // namespace core_perception
