// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include "core_perception/frame_votes.h"
#include "core_perception/free_space.h"
#include "core_perception/instance_memory.h"
#include "core_perception/label_meaning.h"
#include "core_perception/projection.h"
#include "core_perception/safety_grid.h"
#include "core_perception/spatial_operators.h"
#include "core_perception/stage_clock.h"
#include "core_perception/vote_map.h"

namespace core_perception {

/// Semantic grounding: labelled depth images and safety predicates in, decision around the robot
/// out.
///
///     operators -> projection -> votes a frame -> SemanticOcTree -> 2-D counts -+-> decision -> h
///     labels    -> objects    -> instance memory -> regions on the ground  -----+
///
/// Time and pose are arguments. Source: [CORE] semantic grounding. Both profiles take this way,
/// parameters tell them apart.
class SemanticMap {
 public:
  /// @param params validated where they are read, see SemanticMapParams::fromMap.
  explicit SemanticMap(const SemanticMapParams& params);

  /// Adds a frame under the constraints in force at its stamp. While no constraints are in force
  /// objects are tracked but nothing is voted, and no region is made. Exemptions are heeded only
  /// when they count by the numbers of this history, and only by ground operators: those on pixels
  /// know no objects. With parameter semantics false constraints are never in force, and every
  /// point below the metric band or above it votes safe.
  /// @throws FrameError the frame cannot be used; nothing has changed then.
  const SafetyGrid& update(const Frame& frame, const Constraints& constraints);

  const SafetyGrid& grid() const { return composer_.grid(); }
  /// Objects held; those of a class that only ON speaks of are left out while it does.
  const std::vector<HeldInstance>& instances() const { return memory_.instances(); }
  /// In force for the newest frame, with the exemptions that were heeded.
  const std::vector<Predicate>& predicates() const { return predicates_; }
  /// Stamp of the first frame since the map was empty [s]; 0 before it.
  double history_start_s() const { return history_start_s_; }
  VoteMap& votes() { return votes_; }
  const SemanticMapParams& params() const { return params_; }
  /// Forgets what it holds in a box of the fixed frame: voxels whose centre lies in it, objects
  /// that reach into it. What is cleared is unknown then. Where anything was, a new history begins
  /// with the next frame: regions of a forgotten object reached beyond the box, and the ground
  /// there would become safe; who uses the map must ask an operator. The first position of the
  /// robot is kept: no other ground is taken as safe.
  /// @returns whether anything was there.
  bool clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m);
  /// Adds a saved tree of the same resolution. With ground operators only what is unsafe in it:
  /// regions live with their objects, which a tree does not hold, so that what was safe between
  /// yesterday's cones may not be now.
  void load(const SemanticOcTree& saved);
  /// Is told where the time of every update goes; nullptr: nobody.
  void observeStages(StageClock* clock) { stage_clock_ = clock; }
  /// Forgets everything, the first position of the robot included. Numbers of objects are not given
  /// again.
  void clear();

 private:
  std::vector<Predicate> findInForce(const Constraints& constraints) const;
  void collect(const Frame& frame, const Projection& projection, bool vote);
  void collectInstances(const Frame& frame, const Projection& projection, int v);
  FloorBand makeFloorBand(const Projection& projection) const;
  void voteRow(const Frame& frame, const Projection& projection, const FloorBand& floor, int v);
  int32_t locateExactly(const Frame& frame, const Projection& projection, const FloorBand& floor,
                        int u, int v) const;
  void mark(Stage stage) const {
    if (stage_clock_ != nullptr) stage_clock_->mark(stage);
  }
  ColumnRange findReach(const Projection& projection) const;

  SemanticMapParams params_;
  LabelMeanings meanings_;
  CauseTable causes_;
  FrameVotes frame_votes_;
  VoteMap votes_;
  InstanceDetector detector_;
  InstanceMemory memory_;
  GridComposer composer_;
  InitialDisc disc_;
  bool has_disc_ = false;
  double history_start_s_ = 0.0;
  StageClock* stage_clock_ = nullptr;
  std::vector<Predicate> predicates_;
  cv::Mat metres_;
  // Of the frame being added.
  ImageRegions regions_;
  std::vector<uint16_t> rule_causes_;  ///< cause of each predicate, for image operators
  PointRow row_;
  std::vector<int32_t> voxels_;     ///< of the points of row_
  std::vector<int32_t> is_object_;  ///< whether a point of row_ may be one of an object
};

}  // namespace core_perception
