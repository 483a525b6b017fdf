// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/instance_memory.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <tuple>

namespace core_perception {
namespace {

constexpr size_t kNoMatch = std::numeric_limits<size_t>::max();
constexpr double kTouching_m = 0.1;
constexpr size_t kMostCorners = 32;
constexpr int kDoubtOfEmpty = 5;  // of one look that finds another class: 1

double distanceOfCentres(const Polygon& a, const Polygon& b) {
  const Point2 p = computeCentre(a), q = computeCentre(b);
  return std::hypot(p.x - q.x, p.y - q.y);
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

}  // namespace

void InstanceMemory::update(double stamp_s, const std::vector<Detection>& detections,
                            const Probe& probe) {
  for (HeldInstance& held : instances_) held.in_view = false;
  for (HeldInstance& held : hidden_) held.in_view = false;
  const std::vector<size_t> matches = match(detections);
  for (size_t i = 0; i < detections.size(); ++i) {
    if (matches[i] != kNoMatch) absorb(stamp_s, detections[i], &instances_[matches[i]]);
  }
  for (size_t i = 0; i < detections.size(); ++i) {
    if (matches[i] == kNoMatch) placeUnmatched(stamp_s, detections[i]);
  }
  mergeOverlapping();
  releaseEmpty(probe, &instances_);
  releaseEmpty(probe, &hidden_);
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
  const bool small = held->largest_view_m <= params_.max_footprint_m;
  if (small && computeDiameter(united) > held->largest_view_m + params_.footprint_slack_m) {
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
  for (size_t i = 0; i < instances_.size(); ++i) {
    for (size_t j = i + 1; j < instances_.size();) {
      HeldInstance& a = instances_[i];
      const HeldInstance& b = instances_[j];
      // Two that one frame told apart are two, even where their hulls touch.
      const bool told_apart = a.in_view && b.in_view;
      if (told_apart || a.class_name != b.class_name || !areWithin(a.footprint, b.footprint, 0.0)) {
        ++j;
        continue;
      }
      mergeInto(b, &a);
      a.id = ++last_id_;
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

void InstanceMemory::hideClasses(const std::function<bool(const std::string&)>& is_surface) {
  std::vector<HeldInstance> all;
  all.swap(instances_);
  std::move(hidden_.begin(), hidden_.end(), std::back_inserter(all));
  hidden_.clear();
  for (HeldInstance& held : all)
    (is_surface(held.class_name) ? hidden_ : instances_).push_back(std::move(held));
}

int InstanceMemory::clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m) {
  const Polygon box{{min_m.x(), min_m.y()},
                    {max_m.x(), min_m.y()},
                    {max_m.x(), max_m.y()},
                    {min_m.x(), max_m.y()}};
  const auto is_inside = [&](const HeldInstance& held) {
    const bool level = held.z_min_m <= max_m.z() && held.z_max_m >= min_m.z();
    return level && areWithin(held.footprint, box, 0.0);
  };
  int n = 0;
  for (std::vector<HeldInstance>* all : {&instances_, &hidden_}) {
    const auto kept = std::remove_if(all->begin(), all->end(), is_inside);
    n += static_cast<int>(all->end() - kept);
    all->erase(kept, all->end());
  }
  return n;
}

void InstanceMemory::clear() {
  instances_.clear();
  hidden_.clear();
}

void labelClusters(double max_gap_m, std::vector<HeldInstance>* instances) {
  std::vector<HeldInstance>& all = *instances;
  for (HeldInstance& held : all) held.cluster = held.id;
  const auto replace = [&all](uint32_t from, uint32_t to) {
    for (HeldInstance& held : all) {
      if (held.cluster == from) held.cluster = to;
    }
  };
  for (size_t i = 0; i < all.size(); ++i) {
    for (size_t j = i + 1; j < all.size(); ++j) {
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
