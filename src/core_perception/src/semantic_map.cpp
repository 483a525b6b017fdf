// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/semantic_map.h"

#include <cmath>
#include <limits>

#include "core_perception/exceptions.h"
#include "core_perception/place_probe.h"

namespace core_perception {
namespace {

/// OctoMap's keys count 2^15 voxels to each side of the origin; a vote beyond would be lost. Memory
/// is bounded too.
void checkReach(const Projection& projection, double resolution_m, int n_layers) {
  // The scratch volume of a frame takes 16 bytes a voxel.
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

/// End of the run of pixels from u on that carry the label of u.
int findRunEnd(const uint16_t* labels, int u, int end) {
  const uint16_t label = labels[u];
  while (u < end && labels[u] == label) ++u;
  return u;
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
      regions_(params.kernel_px) {}

const SafetyGrid& SemanticMap::update(const Frame& frame, const Constraints& constraints) {
  checkFrame(frame);
  const Projection projection(frame, params_.range);
  checkReach(projection, params_.resolution_m, frame_votes_.layers());
  const bool vote = constraints.isActive() || !params_.semantics;
  if (history_start_s_ == 0.0) history_start_s_ = frame.stamp_s;
  if (!has_disc_) disc_ = InitialDisc{frame.p_map_base, params_.initial_disc_radius_m};
  has_disc_ = true;
  predicates_ = findInForce(constraints);

  convertToMetres(frame.depth, &metres_);
  meanings_.build(frame.classes, predicates_, &causes_);
  mark(Stage::kPrepare);
  if (vote && params_.usesImageOperators()) {
    regions_.compute(frame.labels, frame.classes, predicates_);
    rule_causes_.clear();
    for (const Predicate& p : predicates_)
      rule_causes_.push_back(causes_.intern(formatRule(p), p.class_name));
  }
  mark(Stage::kOperators);
  collect(frame, projection, vote);
  mark(Stage::kPoints);
  if (vote) votes_.add(frame_votes_);
  mark(Stage::kVoxels);
  if (vote && params_.vote.free_space_clearing)
    clearSeenThrough(metres_, projection, frame_votes_, findReach(projection), &votes_);
  mark(Stage::kClearing);
  memory_.hideClasses(
      [this](const std::string& name) { return meanings_.isSurface(name, predicates_); });
  std::vector<std::string> class_names;
  for (const LabelClass& label : frame.classes) class_names.push_back(label.class_name);
  const PlaceProbe probe(frame, metres_, projection, params_.range);
  memory_.update(frame.stamp_s, detector_.finish(class_names),
                 [&probe](const HeldInstance& held) { return probe.look(held); });
  mark(Stage::kInstances);
  std::vector<Region> regions;
  if (!params_.usesImageOperators()) {
    regions =
        buildRegions(memory_.instances(), predicates_, params_.instance, params_.resolution_m);
  }
  mark(Stage::kRegions);
  composer_.compose(votes_, causes_, disc_, regions, frame.p_map_base);
  mark(Stage::kGrid);
  return composer_.grid();
}

std::vector<Predicate> SemanticMap::findInForce(const Constraints& constraints) const {
  if (!constraints.isActive() || !params_.semantics) return {};
  std::vector<Predicate> predicates = constraints.predicates;
  const bool same_history = constraints.instances_history_start_s == history_start_s_;
  if (same_history && !params_.usesImageOperators()) return predicates;
  for (Predicate& predicate : predicates) predicate.exempt_instances.clear();
  return predicates;
}

void SemanticMap::collect(const Frame& frame, const Projection& projection, bool vote) {
  frame_votes_.start(projection.p_map_camera(), projection.reach_m());
  detector_.start(projection.p_map_camera(), projection.reach_m());
  const FloorBand floor = makeFloorBand(projection);
  for (int v = 0; v < metres_.rows; ++v) {
    projection.projectRow(metres_, v, &row_);
    collectInstances(frame, projection, v);
    if (vote) voteRow(frame, projection, floor, v);
  }
}

void SemanticMap::collectInstances(const Frame& frame, const Projection& projection, int v) {
  const uint16_t* labels = frame.labels.ptr<uint16_t>(v);
  const float* depths = metres_.ptr<float>(v);
  const auto stride = static_cast<std::ptrdiff_t>(metres_.step1());
  const float camera_height_m = projection.camera_height_m();
  const auto min_m = static_cast<float>(params_.range.band_min_z_m) - camera_height_m;
  const auto max_m = static_cast<float>(params_.range.band_max_z_m) - camera_height_m;
  const int first = row_.first, end = row_.end;
  const float *depth = row_.depth_m.data(), *dz = row_.dz_m.data();
  is_object_.resize(metres_.cols);
  int32_t* is_object = is_object_.data();
  for (int u = first; u < end; ++u) {
    // Labels bleed farther than depths mix.
    is_object[u] = (depth[u] > 0.0f) & (dz[u] >= min_m) & (dz[u] <= max_m) &
                   !projection.isBehindEdge(depths + u, stride, 2);
  }
  for (int u = first; u < end; ++u) {
    const int16_t slot = meanings_[labels[u]].instance_slot;
    if (slot < 0) {
      u = findRunEnd(labels, u, end) - 1;
    } else if (is_object[u] != 0) {
      detector_.add(slot, {row_.dx_m[u], row_.dy_m[u], dz[u]},
                    camera_height_m + dz[u] >= projection.metricHeight(depth[u]));
    }
  }
}

FloorBand SemanticMap::makeFloorBand(const Projection& projection) const {
  FloorBand floor;
  floor.camera_height_m = projection.camera_height_m();
  floor.metric_min_height_m = projection.metricHeight(0.0f);
  floor.metric_slope = static_cast<float>(params_.range.metric_slope);
  floor.layer = frame_votes_.layerOf(params_.range.floor_z_m);
  if (params_.vote.metric_layer)
    floor.min_height_m = static_cast<float>(params_.range.band_min_z_m);
  return floor;
}

void SemanticMap::voteRow(const Frame& frame, const Projection& projection, const FloorBand& floor,
                          int v) {
  frame_votes_.locate(row_, floor, &voxels_);
  const bool metric_layer = params_.vote.metric_layer;
  const bool by_image = params_.usesImageOperators(), all_safe = !params_.semantics;
  const uint16_t* labels = frame.labels.ptr<uint16_t>(v);
  const uint8_t* regions = by_image ? regions_.image().ptr<uint8_t>(v) : nullptr;
  const auto max_m = static_cast<float>(params_.range.band_max_z_m);
  for (int u = row_.first; u < row_.end; ++u) {
    if (voxels_[u] == FrameVotes::kUndecided)
      voxels_[u] = locateExactly(frame, projection, floor, u, v);
    if (voxels_[u] == FrameVotes::kNoVoxel) continue;
    VoxelTally& tally = frame_votes_.touch(voxels_[u]);
    const LabelMeaning& meaning = meanings_[labels[u]];
    const float height_m = floor.camera_height_m + row_.dz_m[u];
    if (metric_layer && height_m >= projection.metricHeight(row_.depth_m[u]) && height_m <= max_m) {
      if (tally.n_metric < std::numeric_limits<uint16_t>::max()) ++tally.n_metric;
      tally.metric_cause = meaning.metric_cause;
    } else if (all_safe || (by_image ? regions[u] == kSafeRegion : meaning.safe)) {
      ++tally.n_safe;
    } else {
      ++tally.n_unsafe;
      const int rule = by_image ? regions[u] : kNoRegion;
      const bool has_rule = rule > kNoRegion && rule <= kMostRules;
      tally.cause = has_rule ? rule_causes_[rule - 1] : meaning.cause;
    }
  }
}

int32_t SemanticMap::locateExactly(const Frame& frame, const Projection& projection,
                                   const FloorBand& floor, int u, int v) const {
  const bool in_mm = frame.depth.type() == CV_16UC1;
  const double depth_m =
      in_mm ? frame.depth.ptr<uint16_t>(v)[u] / 1000.0 : frame.depth.ptr<float>(v)[u];
  return frame_votes_.locatePoint(projection.computePoint(u, v, depth_m), depth_m, floor);
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

bool SemanticMap::clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m) {
  // Beyond the reach of the tree; an infinite box would make no polygon.
  static constexpr double kFarthest_m = 1e5;
  const auto clamp = [](const Eigen::Vector3d& p) -> Eigen::Vector3d {
    return p.cwiseMax(-kFarthest_m).cwiseMin(kFarthest_m);
  };
  const int n_voxels = votes_.clearBox(clamp(min_m), clamp(max_m));
  const int n_objects = memory_.clearBox(clamp(min_m), clamp(max_m));
  if (n_voxels + n_objects == 0) return false;
  history_start_s_ = 0.0;
  return true;
}

void SemanticMap::load(const SemanticOcTree& saved) {
  votes_.load(saved, params_.usesImageOperators(), causes_.intern(kSavedRule, ""));
}

void SemanticMap::clear() {
  has_disc_ = false;
  votes_.clear();
  memory_.clear();
  causes_.clear();
  predicates_.clear();
  history_start_s_ = 0.0;
}

}  // namespace core_perception
