// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/semantic_map.h"

#include <cmath>
#include <limits>

#include "core_perception/exceptions.h"
#include "core_perception/place_probe.h"

namespace core_perception {
namespace {

/// OctoMap's keys count 2^15 voxels to each side of the origin; a vote beyond would be lost.
void checkReach(const Projection& projection, double resolution_m) {
  const double farthest_m =
      projection.p_map_camera().cwiseAbs().maxCoeff() + projection.reach_m() + resolution_m;
  if (farthest_m <= 32768.0 * resolution_m) return;
  throw FrameError("pose_invalid", "the camera sees farther from the origin than the map reaches");
}

}  // namespace

SemanticMap::SemanticMap(const SemanticMapParams& params)
    : params_(params),
      meanings_(params.instance.surface_classes),
      frame_votes_(params.resolution_m, params.range.floor_z_m + params.range.tree_min_z_m,
                   params.range.floor_z_m + params.range.tree_max_z_m),
      votes_(params.resolution_m, params.range, params.vote),
      detector_(params.resolution_m, params.instance.min_points),
      memory_(params.instance),
      composer_(params),
      floor_layer_(frame_votes_.layerOf(params.range.floor_z_m)) {}

const SafetyGrid& SemanticMap::update(const Frame& frame, const Constraints& constraints) {
  checkFrame(frame);
  const Projection projection(frame, params_.range);
  checkReach(projection, params_.resolution_m);
  const bool vote = constraints.isActive() || !params_.semantics;
  if (history_start_s_ == 0.0) {
    disc_ = InitialDisc{frame.p_map_base, params_.initial_disc_radius_m};
    history_start_s_ = frame.stamp_s;
  }
  predicates_ = findInForce(constraints);

  convertToMetres(frame.depth, &metres_);
  meanings_.build(frame.classes, predicates_, &causes_);
  ImageSets sets;
  if (vote && params_.usesImageOperators()) {
    sets = computeImageSets(frame.labels, frame.classes, predicates_, params_.kernel_px);
    rule_causes_.clear();
    for (const Predicate& p : predicates_)
      rule_causes_.push_back(causes_.intern(formatRule(p), p.class_name));
  }
  collect(frame, projection, sets, vote);
  if (vote) {
    votes_.add(frame_votes_);
    if (params_.vote.free_space_clearing) {
      clearSeenThrough(metres_, projection, frame_votes_, findReach(projection), &votes_);
    }
  }
  memory_.hideClasses(
      [this](const std::string& name) { return meanings_.isSurface(name, predicates_); });
  std::vector<std::string> class_names;
  for (const LabelClass& label : frame.classes) class_names.push_back(label.class_name);
  const PlaceProbe probe(frame, metres_, projection, params_.range);
  memory_.update(frame.stamp_s, detector_.finish(class_names),
                 [&probe](const HeldInstance& held) { return probe.look(held); });
  std::vector<Region> regions;
  if (!params_.usesImageOperators()) {
    regions =
        buildRegions(memory_.instances(), predicates_, params_.instance, params_.resolution_m);
  }
  return composer_.compose(votes_, causes_, disc_, regions, frame.p_map_base);
}

std::vector<Predicate> SemanticMap::findInForce(const Constraints& constraints) const {
  if (!constraints.isActive() || !params_.semantics) return {};
  std::vector<Predicate> predicates = constraints.predicates;
  const bool same_history = constraints.instances_history_start_s == history_start_s_;
  if (same_history && !params_.usesImageOperators()) return predicates;
  for (Predicate& predicate : predicates) predicate.exempt_instances.clear();
  return predicates;
}

void SemanticMap::collect(const Frame& frame, const Projection& projection, const ImageSets& sets,
                          bool vote) {
  camera_height_m_ = projection.camera_height_m();
  p_map_camera_ = projection.p_map_camera();
  frame_votes_.start(p_map_camera_, projection.reach_m());
  detector_.start();
  projection.forEachPoint(metres_, [&](const PixelPoint& point) {
    const LabelMeaning& meaning = meanings_[frame.labels.ptr<uint16_t>(point.v)[point.u]];
    const float height_m = camera_height_m_ + point.dz_m;
    if (meaning.instance_slot >= 0)
      collectInstancePoint(point, height_m, meaning.instance_slot, projection);
    if (vote) votePoint(point, height_m, projection.metricHeight(point.depth_m), meaning, sets);
  });
}

void SemanticMap::collectInstancePoint(const PixelPoint& point, float height_m, int16_t slot,
                                       const Projection& projection) {
  if (height_m < params_.range.band_min_z_m || height_m > params_.range.band_max_z_m) return;
  // Labels bleed farther than depths mix.
  if (projection.isBehindEdge(metres_, point.u, point.v, 2)) return;
  detector_.add(slot, p_map_camera_ + Eigen::Vector3d(point.dx_m, point.dy_m, point.dz_m),
                height_m >= projection.metricHeight(point.depth_m));
}

void SemanticMap::votePoint(const PixelPoint& point, float height_m, float metric_height_m,
                            const LabelMeaning& meaning, const ImageSets& sets) {
  const bool metric_layer = params_.vote.metric_layer;
  // In profile core all floor-level points vote in the layer of the floor: noise must not spread
  // them over two layers.
  const bool floor_level =
      metric_layer && height_m >= params_.range.band_min_z_m && height_m < metric_height_m;
  VoxelTally* tally = floor_level ? frame_votes_.touchLayer(point.dx_m, point.dy_m, floor_layer_)
                                  : frame_votes_.touch(point.dx_m, point.dy_m, point.dz_m);
  if (tally == nullptr) return;
  if (metric_layer && height_m >= metric_height_m && height_m <= params_.range.band_max_z_m) {
    if (tally->n_metric < std::numeric_limits<uint16_t>::max()) ++tally->n_metric;
    tally->metric_cause = meaning.metric_cause;
    return;
  }
  const bool by_image = !sets.safe.empty();
  const bool safe = !params_.semantics ||
                    (by_image ? sets.safe.ptr<uint8_t>(point.v)[point.u] != 0 : meaning.safe);
  ++(safe ? tally->n_safe : tally->n_unsafe);
  if (safe) return;
  const int rule = by_image ? sets.rule.ptr<uint8_t>(point.v)[point.u] : 0;
  tally->cause = rule > 0 ? rule_causes_[rule - 1] : meaning.cause;
}

ColumnRange SemanticMap::findReach(const Projection& projection) const {
  const auto toIndex = [this](double coordinate_m) {
    return static_cast<int>(std::floor(coordinate_m / params_.resolution_m));
  };
  const Eigen::Vector3d& p = projection.p_map_camera();
  const double reach_m = projection.reach_m();
  return {toIndex(p.x() - reach_m), toIndex(p.y() - reach_m), toIndex(p.x() + reach_m),
          toIndex(p.y() + reach_m)};
}

void SemanticMap::clear() {
  votes_.clear();
  memory_.clear();
  causes_.clear();
  predicates_.clear();
  history_start_s_ = 0.0;
}

}  // namespace core_perception
