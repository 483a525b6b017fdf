// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/instance_memory.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <tuple>

namespace core_perception {
namespace {

constexpr size_t kNoMatch = std::numeric_limits<size_t>::max();
constexpr double kTouching_m = 0.1;
constexpr double kWholeShare = 0.8;  // of the largest view
constexpr size_t kMostCorners = 32;
constexpr int kDoubtOfEmpty = 5;  // of one look that finds another class: 1

double distanceOfCentres(const Polygon& a, const Polygon& b) {
  const Point2 p = computeCentre(a), q = computeCentre(b);
  return std::hypot(p.x - q.x, p.y - q.y);
}

std::vector<Box2> boundAll(const std::vector<HeldInstance>& instances) {
  std::vector<Box2> boxes;
  for (const HeldInstance& held : instances) boxes.push_back(computeBounds(held.footprint));
  return boxes;
}

Polygon uniteHulls(const Polygon& a, const Polygon& b) {
  std::vector<Point2> points(a);
  points.insert(points.end(), b.begin(), b.end());
  return simplifyHull(computeConvexHull(std::move(points)), kMostCorners);
}

std::vector<CellIndex> uniteCells(const std::vector<CellIndex>& a,
                                  const std::vector<CellIndex>& b) {
  std::vector<CellIndex> all;
  std::set_union(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(all));
  return all;
}

void mergeInto(const HeldInstance& from, HeldInstance* to) {
  to->footprint = uniteHulls(to->footprint, from.footprint);
  to->cells = uniteCells(to->cells, from.cells);
  to->z_min_m = std::min(to->z_min_m, from.z_min_m);
  to->z_max_m = std::max(to->z_max_m, from.z_max_m);
  to->in_view = to->in_view || from.in_view;
  to->confirmed = to->confirmed || from.confirmed;
  to->last_seen_s = std::max(to->last_seen_s, from.last_seen_s);
  to->frames_seen = std::max(to->frames_seen, from.frames_seen);
  to->doubt = 0;
  to->largest_view_m = std::max(to->largest_view_m, from.largest_view_m);
}

bool isConfirmed(const HeldInstance& held) { return held.confirmed; }
bool isConfirmed(const Detection&) { return false; }

/// Leaves at most `most`, in their order; returns how many went.
template <typename Object>
size_t keepMostDangerous(size_t most, const InstanceMemory::Danger& danger,
                         std::vector<Object>* objects) {
  if (objects->size() <= most) return 0;
  using Rank = std::tuple<bool, bool, double, size_t>;  // the smaller the more dangerous
  std::vector<Rank> ranks;
  for (size_t i = 0; i < objects->size(); ++i) {
    const Object& object = (*objects)[i];
    const bool harmless = danger.is_unsafe && !danger.is_unsafe(object.class_name);
    ranks.emplace_back(harmless, !isConfirmed(object),
                       computeDistance(danger.p_map_base, object.footprint), i);
  }
  std::sort(ranks.begin(), ranks.end());
  // Were all places those of confirmed ones, nothing new could ever be confirmed.
  const auto shared = ranks.begin() + static_cast<std::ptrdiff_t>(most / 2);
  for (auto rank = shared; rank != ranks.end(); ++rank) std::get<1>(*rank) = false;
  std::sort(shared, ranks.end());
  std::vector<bool> is_kept(objects->size(), false);
  for (size_t k = 0; k < most; ++k) is_kept[std::get<3>(ranks[k])] = true;
  std::vector<Object> kept;
  for (size_t i = 0; i < objects->size(); ++i) {
    if (is_kept[i]) kept.push_back(std::move((*objects)[i]));
  }
  const size_t n_dropped = objects->size() - most;
  *objects = std::move(kept);
  return n_dropped;
}

}  // namespace

void InstanceMemory::update(double stamp_s, std::vector<Detection> detections, const Probe& probe,
                            const Danger& danger) {
  for (HeldInstance& held : instances_) held.in_view = false;
  for (HeldInstance& held : hidden_) held.in_view = false;
  n_dropped_ += keepMostDangerous(static_cast<size_t>(params_.max_instances), danger, &detections);
  const std::vector<size_t> matches = match(detections);
  for (size_t i = 0; i < detections.size(); ++i) {
    if (matches[i] != kNoMatch) absorb(stamp_s, detections[i], &instances_[matches[i]]);
  }
  for (size_t i = 0; i < detections.size(); ++i) {
    if (matches[i] == kNoMatch) placeUnmatched(stamp_s, detections[i]);
  }
  limit(danger);
  mergeOverlapping();
  for (std::vector<HeldInstance>* all : {&instances_, &hidden_}) {
    releaseEmpty(probe, all);
    releaseOld(stamp_s, all);
  }
  labelClusters(params_.between_max_gap_m, &instances_);
}

std::vector<size_t> InstanceMemory::match(const std::vector<Detection>& detections) const {
  using Candidate =
      std::tuple<double, double, size_t, size_t>;  // gap, distance of centres, detection, held
  std::vector<Candidate> candidates;
  for (size_t i = 0; i < detections.size(); ++i) {
    for (size_t j = 0; j < instances_.size(); ++j) {
      if (detections[i].class_name != instances_[j].class_name) continue;
      const Polygon &seen = detections[i].footprint, &held = instances_[j].footprint;
      if (areWithin(seen, held, params_.match_distance_m))
        candidates.emplace_back(computeDistance(seen, held), distanceOfCentres(seen, held), i, j);
    }
  }
  std::sort(candidates.begin(), candidates.end());
  std::vector<size_t> matches(detections.size(), kNoMatch);
  std::vector<bool> taken(instances_.size(), false);
  for (const Candidate& candidate : candidates) {
    const size_t i = std::get<2>(candidate), j = std::get<3>(candidate);
    if (matches[i] != kNoMatch || taken[j]) continue;
    matches[i] = j;
    taken[j] = true;
  }
  return matches;
}

void InstanceMemory::placeUnmatched(double stamp_s, const Detection& detection) {
  for (HeldInstance& held : instances_) {
    const bool piece = held.class_name == detection.class_name &&
                       held.isExtended(params_.max_footprint_m) &&
                       areWithin(held.footprint, detection.footprint, kTouching_m);
    if (piece) {  // one more piece of a rack or a wall
      mergeInto(create(stamp_s, detection), &held);
      return;
    }
  }
  instances_.push_back(create(stamp_s, detection));
}

HeldInstance InstanceMemory::create(double stamp_s, const Detection& detection) {
  HeldInstance held;
  held.id = ++last_id_;
  held.class_name = detection.class_name;
  const auto& movers = params_.mobile_classes;
  held.mobile = std::count(movers.begin(), movers.end(), held.class_name) > 0;
  held.footprint = detection.footprint;
  held.cells = detection.cells;
  held.z_min_m = detection.z_min_m;
  held.z_max_m = detection.z_max_m;
  held.in_view = true;
  held.frames_seen = 1;
  held.confirmed = params_.min_frames <= 1;
  held.last_seen_s = stamp_s;
  held.largest_view_m = computeDiameter(detection.footprint);
  return held;
}

void InstanceMemory::absorb(double stamp_s, const Detection& detection, HeldInstance* held) const {
  held->largest_view_m = std::max(held->largest_view_m, computeDiameter(detection.footprint));
  const Polygon united = uniteHulls(held->footprint, detection.footprint);
  const bool bounded = held->mobile || held->largest_view_m <= params_.max_footprint_m;
  const double slack_m = held->mobile ? params_.mobile_slack_m : params_.footprint_slack_m;
  // A view cut off by the border of the image, or by what stands before it, says nothing of the
  // rest; but what drives along such a border must not leave a trail.
  const bool whole = computeDiameter(detection.footprint) >= kWholeShare * held->largest_view_m;
  const double most_m = (whole ? 1.0 : 2.0) * held->largest_view_m + slack_m;
  if (bounded && computeDiameter(united) > most_m) {
    held->footprint = detection.footprint;
    held->cells = detection.cells;
  } else {
    held->footprint = united;
    held->cells = uniteCells(held->cells, detection.cells);
  }
  held->z_min_m = std::min(held->z_min_m, detection.z_min_m);
  held->z_max_m = std::max(held->z_max_m, detection.z_max_m);
  held->in_view = true;
  held->last_seen_s = stamp_s;
  held->doubt = 0;
  ++held->frames_seen;
  held->confirmed =
      held->confirmed || held->frames_seen >= static_cast<uint32_t>(params_.min_frames);
}

void InstanceMemory::mergeOverlapping() {
  std::vector<Box2> boxes = boundAll(instances_);  // most pairs are far apart
  for (size_t i = 0; i < instances_.size(); ++i) {
    for (size_t j = i + 1; j < instances_.size();) {
      HeldInstance& a = instances_[i];
      const HeldInstance& b = instances_[j];
      // Two that one frame told apart are two, even where their hulls touch. So are two that move,
      // where one hides the other: a double goes when its place is seen empty, or by time.
      const bool told_apart = (a.in_view && b.in_view) || (a.mobile && a.confirmed && b.confirmed);
      if (!areWithin(boxes[i], boxes[j], 0.0) || told_apart || a.class_name != b.class_name ||
          !areWithin(a.footprint, b.footprint, 0.0)) {
        ++j;
        continue;
      }
      mergeInto(b, &a);
      a.id = ++last_id_;
      boxes[i] = computeBounds(a.footprint);
      boxes.erase(boxes.begin() + static_cast<std::ptrdiff_t>(j));
      instances_.erase(instances_.begin() + static_cast<std::ptrdiff_t>(j));
    }
  }
}

void InstanceMemory::releaseEmpty(const Probe& probe, std::vector<HeldInstance>* instances) const {
  for (HeldInstance& held : *instances) {
    if (held.in_view) continue;
    const PlaceView view = probe(held);
    if (view == PlaceView::kOccupied) held.doubt = 0;
    if (view == PlaceView::kEmpty) held.doubt += kDoubtOfEmpty;
    if (view == PlaceView::kOther) ++held.doubt;
  }
  const int most = kDoubtOfEmpty * params_.release_frames;
  const auto released = [most](const HeldInstance& held) { return held.doubt >= most; };
  instances->erase(std::remove_if(instances->begin(), instances->end(), released),
                   instances->end());
}

void InstanceMemory::releaseOld(double stamp_s, std::vector<HeldInstance>* instances) const {
  if (params_.mobile_release_s <= 0.0) return;
  for (HeldInstance& held : *instances) held.last_seen_s = std::min(held.last_seen_s, stamp_s);
  const auto is_old = [&](const HeldInstance& held) {
    return held.mobile && stamp_s - held.last_seen_s > params_.mobile_release_s;
  };
  instances->erase(std::remove_if(instances->begin(), instances->end(), is_old), instances->end());
}

void InstanceMemory::limit(const Danger& danger) {
  const auto most = static_cast<size_t>(params_.max_instances);
  n_dropped_ += keepMostDangerous(most, danger, &instances_);
  // Those put aside are of classes that are surfaces now: they make no region.
  n_dropped_ += keepMostDangerous(most - instances_.size(), danger, &hidden_);
}

void InstanceMemory::clear() {
  instances_.clear();
  hidden_.clear();
  aside_.clear();
}

void labelClusters(double max_gap_m, std::vector<HeldInstance>* instances) {
  std::vector<HeldInstance>& all = *instances;
  for (HeldInstance& held : all) held.cluster = held.id;
  const auto replace = [&all](uint32_t from, uint32_t to) {
    for (HeldInstance& held : all) {
      if (held.cluster == from) held.cluster = to;
    }
  };
  const std::vector<Box2> boxes = boundAll(all);
  for (size_t i = 0; i < all.size(); ++i) {
    for (size_t j = i + 1; j < all.size(); ++j) {
      if (!areWithin(boxes[i], boxes[j], max_gap_m)) continue;
      if (!all[i].confirmed || !all[j].confirmed || all[i].class_name != all[j].class_name)
        continue;
      if (all[i].cluster == all[j].cluster ||
          !areWithin(all[i].footprint, all[j].footprint, max_gap_m))
        continue;
      replace(std::max(all[i].cluster, all[j].cluster), std::min(all[i].cluster, all[j].cluster));
    }
  }
}

}  // namespace core_perception
