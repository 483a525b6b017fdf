// SPDX-License-Identifier: BSD-3-Clause
#pragma once

namespace core_perception {

/// The stages of SemanticMap::update, in their order.
enum class Stage {
  kPrepare,    ///< checks, runs and meaning of the labels
  kOperators,  ///< predicates to pixels
  kPoints,     ///< depth image to points, and what one frame counts in their voxels
  kVoxels,     ///< counts into the octree and its columns
  kClearing,   ///< what was seen through
  kObjects,    ///< labelled points to the objects of the frame
  kInstances,  ///< remembered objects
  kRegions,    ///< their regions on the ground
  kGrid        ///< decision and signed distance
};
constexpr int kStages = 9;

/// Is told where the time of an update goes; for measurements.
class StageClock {
 public:
  virtual ~StageClock() = default;
  /// The work since the last call, or since update was entered, belongs to this stage.
  virtual void mark(Stage stage) = 0;
};

}  // namespace core_perception
