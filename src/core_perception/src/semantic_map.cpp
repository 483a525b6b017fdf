// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/semantic_map.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core_perception/exceptions.h"
#include "core_perception/place_probe.h"

namespace core_perception {
namespace {

/// OctoMap's keys count 2^15 voxels to each side of the origin; a vote beyond would be lost. Memory
/// is bounded too.
void checkReach(const Projection& projection, double resolution_m, int n_layers) {
  // The scratch volume of a frame takes 4 bytes a voxel, up to four times that for whole powers.
  constexpr double kMostVoxels = 64e6;
  const double width = 2.0 * projection.reach_m() / resolution_m + 3.0;
  if (width * width * n_layers > kMostVoxels)
    throw FrameError("camera_invalid",
                     "the camera reaches over more than 64 million voxels; allowed: a smaller "
                     "range_max_m or span of the tree, or larger voxels");
  const double farthest_m =
      projection.p_map_camera().cwiseAbs().maxCoeff() + projection.reach_m() + resolution_m;
  if (farthest_m <= SemanticOcTree::kKeyOffset * resolution_m) return;
  throw FrameError("pose_invalid", "the camera sees farther from the origin than the map reaches");
}

/// Where unknown ground is safe nobody may be forgotten: what fades would become free ground.
VoteParams chooseVoteParams(const SemanticMapParams& params) {
  VoteParams vote = params.vote;
  if (!params.unknown_is_unsafe) vote.mobile_half_life_s = 0.0;
  return vote;
}

}  // namespace

SemanticMap::SemanticMap(const SemanticMapParams& params)
    : params_(params),
      by_image_(params.usesImageOperators()),
      meanings_(params.instance.surface_classes),
      causes_(params.instance.mobile_classes),
      frame_votes_(params.resolution_m, params.range.floor_z_m + params.range.tree_min_z_m,
                   params.range.floor_z_m + params.range.tree_max_z_m),
      votes_(params.resolution_m, params.range, chooseVoteParams(params)),
      detector_(params.resolution_m, params.instance.min_points),
      memory_(params.instance),
      composer_(params),
      floor_(params.range, params.initial_disc_radius_m),
      regions_(params.kernel_px) {
  if (params.window.keep_radius_m > 0.0) window_ = std::make_unique<RollingWindow>(params);
  nameRules();
}

const SafetyGrid& SemanticMap::update(const Frame& frame, const Constraints& constraints) {
  checkFrame(frame);
  const Projection projection(frame, params_.range);
  checkReach(projection, params_.resolution_m, frame_votes_.layers());
  const bool vote = constraints.isActive() || !params_.semantics;
  if (history_start_s_ == 0.0) history_start_s_ = frame.stamp_s;
  if (!has_disc_) disc_ = InitialDisc{frame.p_map_base, params_.initial_disc_radius_m};
  has_disc_ = true;
  predicates_ = findInForce(constraints);
  if (window_ != nullptr) followRobot(frame, projection);

  meanings_.build(frame.classes, predicates_, &causes_);
  label_runs_.build(frame.labels);
  mark(Stage::kPrepare);
  if (vote && by_image_) {
    regions_.compute(label_runs_, frame.classes, predicates_);
    nameRules();
  }
  mark(Stage::kOperators);
  makeMetres(frame.depth, &metres_);
  if (!vote || params_.range.local_floor) convertToMetres(frame.depth, &metres_);
  if (params_.range.local_floor) floor_.update(metres_, projection, frame.p_map_base);
  frame_votes_.start(projection.p_map_camera(), projection.reach_m());
  if (vote) collectVotes(frame, projection);
  mark(Stage::kPoints);
  if (vote) votes_.add(frame_votes_, causes_);
  votes_.fade(frame.stamp_s);
  mark(Stage::kVoxels);
  if (vote && params_.vote.free_space_clearing)
    clearSeenThrough(metres_, projection, frame_votes_, floor_, &votes_);
  mark(Stage::kClearing);
  collectObjects(projection);
  std::vector<std::string> class_names;
  for (const LabelClass& label : frame.classes) class_names.push_back(label.class_name);
  const std::vector<Detection> detections = detector_.finish(class_names);
  mark(Stage::kObjects);
  memory_.hideClasses(
      [this](const std::string& name) { return meanings_.isSurface(name, predicates_); });
  const PlaceProbe probe(frame, metres_, projection, params_.range, floor_);
  const auto is_unsafe = [this](const std::string& name) {
    return std::any_of(predicates_.begin(), predicates_.end(), [&name](const Predicate& p) {
      return p.isUnsafe() && p.class_name == name;
    });
  };
  memory_.update(frame.stamp_s, detections,
                 [&probe](const HeldInstance& held) { return probe.look(held); },
                 {frame.p_map_base, is_unsafe});
  mark(Stage::kInstances);
  std::vector<Region> regions;
  if (!by_image_) {
    regions =
        buildRegions(memory_.instances(), predicates_, params_.instance, params_.resolution_m);
  }
  mark(Stage::kRegions);
  composer_.compose(votes_, causes_, disc_, regions, frame.p_map_base);
  mark(Stage::kGrid);
  return composer_.grid();
}

void SemanticMap::followRobot(const Frame& frame, const Projection& projection) {
  const Point2& robot = frame.p_map_base;
  const Eigen::Vector3d& camera = projection.p_map_camera();
  const double lever_m = std::hypot(camera.x() - robot.x, camera.y() - robot.y);
  const double radius_m = findLargestRadius(predicates_, params_.instance);
  const bool forgot =
      window_->follow(robot, lever_m + projection.reach_m(), radius_m, &votes_, &memory_);
  // Ground that was seen and forgotten is unknown: what the disc says of it held before.
  if (forgot) disc_.radius_m = 0.0;
}

std::vector<Predicate> SemanticMap::findInForce(const Constraints& constraints) const {
  if (!constraints.isActive() || !params_.semantics) return {};
  std::vector<Predicate> predicates = constraints.predicates;
  const bool same_history = constraints.instances_history_start_s == history_start_s_;
  if (same_history && !by_image_) return predicates;
  for (Predicate& predicate : predicates) predicate.exempt_instances.clear();
  return predicates;
}

bool SemanticMap::clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m) {
  // Beyond the reach of the tree; an infinite box would make no polygon.
  static constexpr double kFarthest_m = 1e5;
  const auto clamp = [](const Eigen::Vector3d& p) -> Eigen::Vector3d {
    return p.cwiseMax(-kFarthest_m).cwiseMin(kFarthest_m);
  };
  const int n_voxels = votes_.clearBox(clamp(min_m), clamp(max_m));
  const int n_objects = memory_.clearBox(clamp(min_m), clamp(max_m));
  const int n_away = window_ ? window_->clearBox(clamp(min_m), clamp(max_m)) : 0;
  if (n_voxels + n_objects + n_away == 0) return false;
  // Of squares on the disk more is forgotten than the box, and that it was ever seen.
  if (n_away > 0) disc_.radius_m = 0.0;
  history_start_s_ = 0.0;
  return true;
}

void SemanticMap::load(const SemanticOcTree& saved) {
  votes_.load(saved, by_image_, causes_.intern(kSavedRule, ""));
}

void SemanticMap::clear() {
  has_disc_ = false;
  floor_.clear();
  votes_.clear();
  memory_.clear();
  if (window_ != nullptr) window_->clear();
  causes_.clear();
  predicates_.clear();
  history_start_s_ = 0.0;
}

}  // namespace core_perception
