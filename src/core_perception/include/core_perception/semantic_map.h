// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "core_perception/frame_votes.h"
#include "core_perception/free_space.h"
#include "core_perception/instance_memory.h"
#include "core_perception/label_meaning.h"
#include "core_perception/local_floor.h"
#include "core_perception/projection.h"
#include "core_perception/rolling_window.h"
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
  /// Of the rolling window, all zero without one.
  RollingWindow::Status windowStatus() const {
    return window_ == nullptr ? RollingWindow::Status() : window_->status();
  }
  /// Objects held; those of a class that only ON speaks of are left out while it does.
  const std::vector<HeldInstance>& instances() const { return memory_.instances(); }
  /// Objects left out because there were more than max_instances, in all.
  uint64_t countDroppedInstances() const { return memory_.countDropped(); }
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
  void followRobot(const Frame& frame, const Projection& projection);
  std::vector<Predicate> findInForce(const Constraints& constraints) const;
  void collectVotes(const Frame& frame, const Projection& projection);
  void collectObjects(const Projection& projection);
  void addObjectPoints(const Projection& projection, const Run& pixels, int16_t slot);
  /// Points of a row, with heights above the local floor where that is asked for.
  void projectRow(const Projection& projection, int v, const Run& pixels, int edge_px);
  FloorBand makeFloorBand(const Projection& projection) const;
  void voteRow(const Frame& frame, const Projection& projection, const FloorBand& floor, int v);
  void findMetric(const FloorBand& floor);
  /// What a pixel says, wherever its point lies.
  struct PixelVote {
    VoteKind kind = kUnsafeVote;
    uint16_t cause = kNoCause;
  };
  /// @param region see ImageRegions, kNoRegion without image operators.
  /// @param metric see findMetric.
  PixelVote makeVote(uint16_t label, uint8_t region, uint8_t metric) const;
  void findRuns(const uint16_t* labels, const uint8_t* regions);
  void nameRules();
  static constexpr uint8_t kObstacle = 1, kDrop = 2;  ///< of findMetric
  int32_t locateExactly(const Frame& frame, const Projection& projection, const FloorBand& floor,
                        int u, int v) const;
  void mark(Stage stage) const {
    if (stage_clock_ != nullptr) stage_clock_->mark(stage);
  }

  SemanticMapParams params_;
  bool by_image_;  ///< image operators
  LabelMeanings meanings_;
  CauseTable causes_;
  FrameVotes frame_votes_;
  VoteMap votes_;
  InstanceDetector detector_;
  InstanceMemory memory_;
  std::unique_ptr<RollingWindow> window_;  ///< null: everything is kept in memory
  GridComposer composer_;
  LocalFloor floor_;
  InitialDisc disc_;
  bool has_disc_ = false;
  double history_start_s_ = 0.0;
  StageClock* stage_clock_ = nullptr;
  std::vector<Predicate> predicates_;
  cv::Mat metres_;
  // Of the frame being added.
  LabelRuns label_runs_;
  ImageRegions regions_;
  /// Cause by region of the image operators; kNoCause where the label tells it.
  std::array<uint16_t, kSafeRegion + 1> region_causes_;
  PointRow row_;
  PixelRow<int32_t> voxels_;             ///< of the points of row_
  PixelRow<uint8_t> metric_;             ///< where they lie, see findMetric
  PixelRow<uint8_t> differs_, changes_;  ///< see findRuns
};

}  // namespace core_perception
