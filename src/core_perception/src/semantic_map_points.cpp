// SPDX-License-Identifier: BSD-3-Clause
// What a SemanticMap takes from the pixels of a frame: votes and points of objects.
#include <algorithm>
#include <cstring>
#include <limits>

#include "core_perception/semantic_map.h"

namespace core_perception {
namespace {

/// changes[u] = 1 where a value differs from that of u - 1, else 0, for u in (first, end).
template <typename T>
void markChanges(const T* values, const Run& pixels, uint8_t* changes) {
  for (int u = pixels.first + 1; u < pixels.end; ++u)
    changes[u] = static_cast<uint8_t>(values[u] != values[u - 1]);
}

/// Adds those of further values.
template <typename T>
void addChanges(const T* values, const Run& pixels, uint8_t* changes) {
  for (int u = pixels.first + 1; u < pixels.end; ++u)
    changes[u] = static_cast<uint8_t>(changes[u] | (values[u] != values[u - 1]));
}

constexpr int kFlagMargin = 64;  ///< forEachSet reads so many flags more

/// Bit i tells of flag i, each 0 or 1; eight at a time are brought together by one product.
uint64_t gatherBits(const uint8_t* flags) {
  uint64_t bits = 0;
  for (int i = 0; i < 8; ++i) {
    uint64_t eight;
    std::memcpy(&eight, flags + 8 * i, sizeof(eight));
    bits |= (eight * 0x0102040810204080u >> 56) << 8 * i;
  }
  return bits;
}

/// Visits the set ones among flags that are 0 or 1, without a branch for each of them.
template <typename Visitor>
void forEachSet(const uint8_t* flags, const Run& pixels, Visitor visit) {
  for (int first = pixels.first; first < pixels.end; first += 64) {
    uint64_t bits = gatherBits(flags + first);
    if (pixels.end - first < 64) bits &= (uint64_t{1} << (pixels.end - first)) - 1;
    for (; bits != 0; bits &= bits - 1) visit(first + __builtin_ctzll(bits));
  }
}

}  // namespace

void SemanticMap::collectObjects(const Projection& projection) {
  constexpr int kEdge_px = 2;  // labels bleed farther than depths mix
  detector_.start(projection.p_map_camera(), projection.reach_m());
  const auto slotOf = [this](const LabelRuns::LabelRun& run) {
    return meanings_[run.label].instance_slot;
  };
  const auto mayBeObject = [&slotOf](const LabelRuns::LabelRun& run) { return slotOf(run) >= 0; };
  for (int v = 0; v < label_runs_.height(); ++v) {
    const auto *run = label_runs_.begin(v), *end = label_runs_.end(v);
    run = std::find_if(run, end, mayBeObject);
    if (run == end) continue;
    while (!mayBeObject(end[-1])) --end;
    projectRow(projection, v, {run->first, end[-1].end}, kEdge_px);
    for (; run != end; ++run) {
      if (mayBeObject(*run)) addObjectPoints(projection, *run, slotOf(*run));
    }
  }
}

/// Adds the points of row_ with the label of a class that has objects.
void SemanticMap::addObjectPoints(const Projection& projection, const Run& pixels, int16_t slot) {
  const float camera_height_m = projection.camera_height_m();
  const auto min_m = static_cast<float>(params_.range.band_min_z_m) - camera_height_m;
  const auto max_m = static_cast<float>(params_.range.band_max_z_m) - camera_height_m;
  const float *depth = row_.depth_m.data(), *dz = row_.dz_m.data();
  const int end = std::min(pixels.end, row_.end);
  for (int u = std::max(pixels.first, row_.first); u < end; ++u) {
    if (depth[u] == 0.0f || dz[u] < min_m || dz[u] > max_m) continue;
    detector_.add(slot, {row_.dx_m[u], row_.dy_m[u], dz[u]},
                  camera_height_m + dz[u] >= projection.metricHeight(depth[u]));
  }
}

void SemanticMap::collectVotes(const Frame& frame, const Projection& projection) {
  const FloorBand floor = makeFloorBand(projection);
  const bool is_converted = params_.range.local_floor;
  const auto convert = [&frame, is_converted, this](int v) {
    if (!is_converted && v < metres_.rows) convertRowToMetres(frame.depth, v, &metres_);
  };
  convert(0);
  for (int v = 0; v < metres_.rows; ++v) {
    convert(v + 1);  // edges are looked for one row ahead
    projectRow(projection, v, {0, metres_.cols}, 1);
    if (row_.first < row_.end) voteRow(frame, projection, floor, v);
  }
}

void SemanticMap::projectRow(const Projection& projection, int v, const Run& pixels, int edge_px) {
  projection.projectRow(metres_, v, pixels, edge_px, &row_);
  if (params_.range.local_floor) floor_.level(&row_);
}

FloorBand SemanticMap::makeFloorBand(const Projection& projection) const {
  FloorBand floor;
  floor.camera_height_m = projection.camera_height_m();
  floor.metric_min_height_m = projection.metricHeight(0.0f);
  floor.metric_slope = static_cast<float>(params_.range.metric_slope);
  floor.layer = frame_votes_.layerOf(params_.range.floor_z_m);
  if (params_.vote.metric_layer)
    floor.min_height_m = static_cast<float>(params_.range.band_min_z_m);
  // What lies below the floor makes the floor there unsafe.
  if (params_.range.local_floor) floor.min_height_m = -std::numeric_limits<float>::infinity();
  return floor;
}

void SemanticMap::voteRow(const Frame& frame, const Projection& projection, const FloorBand& floor,
                          int v) {
  frame_votes_.locate(row_, floor, &voxels_);
  findMetric(floor);
  const uint16_t* labels = frame.labels.ptr<uint16_t>(v);
  const uint8_t* regions = by_image_ ? regions_.image().ptr<uint8_t>(v) : nullptr;
  findRuns(labels, regions);
  const int* voxels = voxels_.data();
  const uint8_t* differs = differs_.data();
  PixelVote vote;
  FrameVotes::RowCounter counter(&frame_votes_, static_cast<size_t>(row_.end - row_.first));
  int first = row_.first;
  const auto voteRun = [&](int end) {
    const int voxel = voxels[first];
    if (differs[first] != 0)
      vote = makeVote(labels[first], by_image_ ? regions[first] : kNoRegion, metric_[first]);
    if (voxel != FrameVotes::kUndecided) {
      counter.add(voxel, vote.kind, static_cast<uint32_t>(end - first), vote.cause);
    } else {
      for (int u = first; u < end; ++u)
        counter.add(locateExactly(frame, projection, floor, u, v), vote.kind, 1, vote.cause);
    }
    first = end;
  };
  forEachSet(changes_.data(), {first + 1, row_.end}, voteRun);
  voteRun(row_.end);
}

SemanticMap::PixelVote SemanticMap::makeVote(uint16_t label, uint8_t region, uint8_t metric) const {
  const LabelMeaning& meaning = meanings_[label];
  const bool safe = !params_.semantics || (by_image_ ? region == kSafeRegion : meaning.safe);
  PixelVote vote;
  // A drop counts by the majority of a voxel: on glossy floor some points are reflections.
  vote.kind = metric == kObstacle ? kMetricVote : safe && metric == 0 ? kSafeVote : kUnsafeVote;
  const uint16_t rule = region_causes_[region];
  vote.cause = metric != 0 ? meaning.metric_cause : rule != kNoCause ? rule : meaning.cause;
  return vote;
}

/// Which points of row_ lie in the metric band (kObstacle), or as far below the local floor as an
/// obstacle stands above it (kDrop).
void SemanticMap::findMetric(const FloorBand& floor) {
  metric_.resize(row_.depth_m.size());
  if (!params_.vote.metric_layer) return;
  const auto max_m = static_cast<float>(params_.range.band_max_z_m);
  // Without a local floor nothing is a drop.
  const float lowest_m = params_.range.local_floor ? static_cast<float>(params_.range.band_min_z_m)
                                                   : -std::numeric_limits<float>::infinity();
  const uint8_t drop = params_.range.local_floor ? kDrop : 0;
  const FloorBand low = floor;  // a copy: nobody else can write to it
  const float *depth = row_.depth_m.data(), *dz = row_.dz_m.data();
  uint8_t* metric = metric_.data();
  for (int u = row_.first, end = row_.end; u < end; ++u) {
    const float height_m = low.camera_height_m + dz[u];
    const float min_m = low.metric_min_height_m + low.metric_slope * depth[u];
    const bool is_drop = (height_m < lowest_m) | (height_m < -min_m);
    const bool is_obstacle = (height_m >= min_m) & (height_m <= max_m);
    metric[u] = static_cast<uint8_t>((is_obstacle ? kObstacle : 0) | (is_drop ? drop : 0));
  }
}

/// Finds the runs of pixels of row_ that vote alike for one voxel; neighbours mostly do. changes_
/// is 1 where another run begins, differs_ where it votes otherwise than the one before it.
void SemanticMap::findRuns(const uint16_t* labels, const uint8_t* regions) {
  const Run pixels{row_.first, row_.end};
  differs_.resize(row_.depth_m.size());
  changes_.resize(row_.depth_m.size() + kFlagMargin);
  uint8_t *differs = differs_.data(), *changes = changes_.data();
  markChanges(labels, pixels, differs);
  if (by_image_) addChanges(regions, pixels, differs);
  if (params_.vote.metric_layer) addChanges(metric_.data(), pixels, differs);
  differs[pixels.first] = 1;
  markChanges(voxels_.data(), pixels, changes);
  for (int u = pixels.first + 1; u < pixels.end; ++u)
    changes[u] = static_cast<uint8_t>(changes[u] | differs[u]);
}

/// Fills the causes of the regions in which an unsafe predicate holds.
void SemanticMap::nameRules() {
  region_causes_.fill(kNoCause);
  for (size_t i = 0; i < predicates_.size() && i < kMostRules; ++i)
    region_causes_[i + 1] = causes_.intern(formatRule(predicates_[i]), predicates_[i].class_name);
}

int32_t SemanticMap::locateExactly(const Frame& frame, const Projection& projection,
                                   const FloorBand& floor, int u, int v) const {
  const bool in_mm = frame.depth.type() == CV_16UC1;
  const double depth_m =
      in_mm ? frame.depth.ptr<uint16_t>(v)[u] / 1000.0 : frame.depth.ptr<float>(v)[u];
  Eigen::Vector3d d_m = projection.computePoint(u, v, depth_m);
  if (params_.range.local_floor) {
    const Eigen::Vector3d p = projection.p_map_camera() + d_m;
    d_m.z() -= floor_.height_m(p.x(), p.y());
  }
  return frame_votes_.locatePoint(d_m, depth_m, floor);
}

}  // namespace core_perception
