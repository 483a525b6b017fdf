// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/params.h"
#include "core_perception/safety_grid.h"
#include "core_perception/semantic_octree.h"

namespace core_perception {
namespace bench {

/// What profile `paper` defines, in double precision and without any haste: every pixel within
/// range is one vote for its voxel, a column is the sum of its voxels that reach into the band,
/// and a cell is safe when n_safe / (n_safe + n_unsafe) >= tau. Shares no code with the library.
class ReferenceMap {
 public:
  /// @throws std::runtime_error parameters of another estimator than that of `paper`.
  explicit ReferenceMap(const SemanticMapParams& params);

  void update(const Frame& frame, const std::vector<Predicate>& predicates);

  /// Pixels that have voted.
  uint64_t observations() const { return observations_; }
  /// Cells of the window that either side knows, added to *compared, and those decided otherwise.
  uint64_t countDifferent(const SafetyGrid& grid, uint64_t* compared) const;
  /// Pixels that voted for another voxel or another side than here.
  uint64_t countDifferent(const SemanticOcTree& tree) const;

 private:
  using Voxel = std::array<int, 3>;
  struct Votes {
    uint64_t n_safe = 0, n_unsafe = 0;
  };

  CellState decide(int x, int y) const;

  SemanticMapParams params_;
  std::map<Voxel, Votes> voxels_;
  std::map<std::array<int, 2>, Votes> columns_;
  Point2 first_;
  bool started_ = false;
  uint64_t observations_ = 0;
};

/// Votes of all leaves of a tree together.
uint64_t sumLeafCounts(const SemanticOcTree& tree);

}  // namespace bench
}  // namespace core_perception
