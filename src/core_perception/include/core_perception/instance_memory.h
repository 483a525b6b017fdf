// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "core_perception/instance_detector.h"
#include "core_perception/params.h"

namespace core_perception {

/// An object held in memory.
struct HeldInstance {
  uint32_t id = 0;  ///< > 0, never given twice by one memory, clear() or not
  std::string class_name;
  bool mobile = false;  ///< its class moves by itself
  Polygon footprint;
  std::vector<CellIndex> cells;  ///< map cells it touched, sorted
  double z_min_m = 0.0, z_max_m = 0.0;
  uint32_t cluster = 0;    ///< smallest id of the cluster
  bool in_view = false;    ///< the newest frame saw it
  bool confirmed = false;  ///< seen in min_frames frames: it makes regions
  double last_seen_s = 0.0;
  uint32_t frames_seen = 0;
  int doubt = 0;  ///< grows with looks that found its place empty or taken by something else
  double largest_view_m = 0.0;  ///< diameter of the largest single view

  bool isExtended(double max_footprint_m) const {
    return computeDiameter(footprint) > max_footprint_m;
  }
};

/// What a frame tells about the place of an object it did not see.
enum class PlaceView {
  kHidden,    ///< out of view, out of range or behind something: nothing can be said
  kOccupied,  ///< something stands there still
  kOther,     ///< what stands there carries the label of another class
  kEmpty,     ///< the floor of the place is seen and nothing on it
};

/// Objects remembered in the fixed frame. Source: DESIGN section 4, row 4; not in [CORE].
///
/// - Detections are matched to held objects by class and distance of footprints, nearest first;
/// label values play no part.
///   A further detection of the same class that touches a held object is merged into it, any other
///   becomes a new object.
/// - The footprint is the hull of all views. For a small object it may grow by footprint_slack_m
/// beyond its largest
///   single view: when it would grow more the object has moved, or the pose has drifted, and the
///   newest view replaces it, unless that is much smaller and so shows a part of it.
/// - Where two held objects turn out to be one, it gets a number of its own: what was said of one
/// of them (an exemption of a predicate) was not said of the other.
/// - An object is held while out of view or hidden, without limit of time, and forgotten only after
/// release_frames
///   consecutive looks at its place found it empty; a look that says nothing changes nothing. A
///   look that finds something of another class there (a label that had bled onto a wall) counts a
///   fifth of that.
/// - One of a class that moves is also forgotten mobile_release_s after the newest frame that saw
///   it. Its footprint, however large, is bounded by mobile_slack_m. Two of them that were both
///   confirmed are never merged: people pass in front of each other.
/// - Of more than max_instances the least dangerous are forgotten: first those of classes of which
///   nothing unsafe is said, then the farthest. Half of the places are kept for the nearest of
///   those that make regions, so that no crowd of one-frame ghosts drives them out.
/// - It makes regions after min_frames sightings. Before, its own points already count as votes, so
/// a hazard seen once
///   stands; only what reaches beyond it (AROUND, BETWEEN) waits for the second look. One-frame
///   ghosts make no region.
class InstanceMemory {
 public:
  using Probe = std::function<PlaceView(const HeldInstance&)>;
  /// By what the danger of an object is judged where there are too many.
  struct Danger {
    Point2 p_map_base;
    std::function<bool(const std::string& class_name)> is_unsafe;  ///< empty: every class is
  };

  explicit InstanceMemory(const InstanceParams& params) : params_(params) {}

  /// @param stamp_s may go back: what was seen later was seen now, then.
  void update(double stamp_s, std::vector<Detection> detections, const Probe& probe,
              const Danger& danger = Danger());
  const std::vector<HeldInstance>& instances() const { return instances_; }
  /// Puts aside the objects of the classes that are surfaces now, and takes back those whose class
  /// no longer is. An object put aside is not among instances(), but still released as any other.
  void hideClasses(const std::function<bool(const std::string&)>& is_surface);
  /// Puts aside, or forgets, the clusters whose hull is farther than leave_m from a place, and
  /// takes back those put aside that are nearer than return_m. What is put aside is not among
  /// instances() and takes no part in anything.
  void keepAround(const Point2& place, double return_m, double leave_m, bool forget);
  /// Forgets the objects that reach into a box; returns how many.
  int clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m);
  void clear();
  /// Objects and detections left out because of max_instances, in all.
  uint64_t countDropped() const { return n_dropped_; }

 private:
  struct AsideCluster {
    Box2 bounds{0.0, 0.0, 0.0, 0.0};
    std::vector<HeldInstance> members;
  };

  void limit(const Danger& danger);
  std::vector<size_t> match(const std::vector<Detection>& detections) const;
  void placeUnmatched(double stamp_s, const Detection& detection);
  HeldInstance create(double stamp_s, const Detection& detection);
  void absorb(double stamp_s, const Detection& detection, HeldInstance* held) const;
  void mergeOverlapping();
  void releaseEmpty(const Probe& probe, std::vector<HeldInstance>* instances) const;
  void releaseOld(double stamp_s, std::vector<HeldInstance>* instances) const;

  InstanceParams params_;
  std::vector<HeldInstance> instances_, hidden_;
  std::vector<AsideCluster> aside_;
  uint32_t last_id_ = 0;
  uint64_t n_dropped_ = 0;
};

/// Gives the confirmed objects of one class that are linked by gaps <= max_gap_m one cluster number
/// (single link). Others are clusters of their own.
void labelClusters(double max_gap_m, std::vector<HeldInstance>* instances);

}  // namespace core_perception
