// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/place_probe.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace core_perception {
namespace {

constexpr double kMargin_m = 0.03;   // around the footprint, so that one seen edge-on has an inside
constexpr double kOverhang_m = 0.3;  // what begins higher hangs over the floor
constexpr int kFewestExpected = 4;   // pixels
constexpr double kFloorShare = 0.6;
constexpr double kStandingShare = 0.05;  // of the expected pixels: stray points
constexpr double kOtherShare = 0.9;
constexpr int kMostPixels = 4000;  // more are thinned out

Polygon grow(const Polygon& footprint) {
  std::vector<Point2> corners;
  for (const Point2& corner : footprint) {
    const Polygon square = makeSquare(corner, 2.0 * kMargin_m);
    corners.insert(corners.end(), square.begin(), square.end());
  }
  return computeConvexHull(std::move(corners));
}

}  // namespace

PlaceView PlaceProbe::look(const HeldInstance& held) const {
  if (!isInView(held.footprint)) return PlaceView::kHidden;  // cheap for the many far away
  const Polygon place = grow(held.footprint);
  if (!isInView(place)) return PlaceView::kHidden;
  if (!isBodyInView(held)) return PlaceView::kHidden;
  const bool flat = held.z_max_m - range_.floor_z_m < range_.metric_min_height_m;
  const auto& evaluated = frame_.classes_evaluated;
  const bool looked_for = std::count(evaluated.begin(), evaluated.end(), held.class_name) > 0;
  if (flat && !looked_for) return PlaceView::kHidden;
  const Evidence seen = gather(place, findPixels(place, held.z_max_m), held.class_name);
  if (seen.n_standing > kStandingShare * seen.n_expected) {
    const bool other = looked_for && seen.n_other >= kOtherShare * seen.n_standing;
    return other ? PlaceView::kOther : PlaceView::kOccupied;
  }
  const bool empty =
      seen.n_expected >= kFewestExpected && seen.n_floor >= kFloorShare * seen.n_expected;
  return empty ? PlaceView::kEmpty : PlaceView::kHidden;
}

Eigen::Vector3d PlaceProbe::projectAbove(const Point2& place, double height_m) const {
  const double floor_m = range_.floor_z_m + floor_.height_m(place.x, place.y);
  return projection_.project({place.x, place.y, floor_m + height_m});
}

bool PlaceProbe::isInView(const Polygon& place) const {
  return std::all_of(place.begin(), place.end(), [&](const Point2& corner) {
    const Eigen::Vector3d pixel = projectAbove(corner, 0.0);
    return pixel.z() >= range_.range_min_m && pixel.z() <= range_.range_max_m &&
           projection_.isInImage(pixel);
  });
}

bool PlaceProbe::isBodyInView(const HeldInstance& held) const {
  const double low_m = held.z_min_m - range_.floor_z_m, high_m = held.z_max_m - range_.floor_z_m;
  if (low_m <= kOverhang_m) return true;  // its foot is on the floor of its place
  const double top_m = std::max(low_m, std::min(high_m, range_.band_max_z_m));
  return std::all_of(held.footprint.begin(), held.footprint.end(), [&](const Point2& corner) {
    return projection_.isInImage(projectAbove(corner, low_m)) &&
           projection_.isInImage(projectAbove(corner, top_m));
  });
}

cv::Rect PlaceProbe::findPixels(const Polygon& place, double top_z_m) const {
  std::vector<cv::Point> corners;
  for (const Point2& corner : place) {
    for (const double height_m : {0.0, top_z_m - range_.floor_z_m}) {
      const Eigen::Vector3d pixel = projectAbove(corner, height_m);
      const Camera& camera = projection_.camera();
      if (pixel.z() < range_.range_min_m) continue;  // its upper end leans behind the camera
      corners.emplace_back(
          static_cast<int>(std::floor(std::min(std::max(pixel.x(), 0.0), camera.width_px - 1.0))),
          static_cast<int>(std::floor(std::min(std::max(pixel.y(), 0.0), camera.height_px - 1.0))));
    }
  }
  cv::Rect box = cv::boundingRect(corners);
  box += cv::Size(1, 1);  // floor above may have cut the last column and row
  return box & cv::Rect(0, 0, metres_.cols, metres_.rows);
}

PlaceProbe::Owner PlaceProbe::findOwner(uint16_t label, const std::string& class_name) const {
  for (const LabelClass& listed : frame_.classes) {
    if (listed.id == label && label != 0)
      return listed.class_name == class_name ? Owner::kSame : Owner::kOther;
  }
  return Owner::kNone;
}

PlaceProbe::Evidence PlaceProbe::gather(const Polygon& place, const cv::Rect& pixels,
                                        const std::string& class_name) const {
  Evidence evidence;
  const Box2 bounds = computeBounds(place);
  evidence.floor_m =
      floor_.height_m(0.5 * (bounds.min_x + bounds.max_x), 0.5 * (bounds.min_y + bounds.max_y));
  Owner owner = Owner::kNone;
  uint16_t last_label = 0;
  const int step =
      std::max(1, static_cast<int>(std::sqrt(static_cast<double>(pixels.area()) / kMostPixels)));
  for (int v = pixels.y; v < pixels.y + pixels.height; v += step) {
    const uint16_t* labels = frame_.labels.ptr<uint16_t>(v);
    for (int u = pixels.x; u < pixels.x + pixels.width; u += step) {
      if (u == pixels.x || labels[u] != last_label)
        owner = findOwner(last_label = labels[u], class_name);
      judgePixel(place, u, v, owner, &evidence);
    }
  }
  return evidence;
}

void PlaceProbe::judgePixel(const Polygon& place, int u, int v, Owner owner,
                            Evidence* evidence) const {
  const Eigen::Vector3d& camera = projection_.p_map_camera();
  const Eigen::Vector3f ray = projection_.ray(u, v);
  if (ray.z() < 0.0f) {
    const float floor_depth_m = (evidence->floor_m - projection_.camera_height_m()) / ray.z();
    if (contains(place,
                 {camera.x() + ray.x() * floor_depth_m, camera.y() + ray.y() * floor_depth_m})) {
      ++evidence->n_expected;
    }
  }
  const float depth_m = metres_.ptr<float>(v)[u];
  if (depth_m <= 0.0f) return;
  const Point2 point{camera.x() + ray.x() * depth_m, camera.y() + ray.y() * depth_m};
  if (!contains(place, point)) return;
  const float height_m =
      projection_.camera_height_m() + ray.z() * depth_m - floor_.height_m(point.x, point.y);
  if (owner == Owner::kSame ||
      (height_m >= projection_.metricHeight(depth_m) && height_m <= range_.band_max_z_m)) {
    ++evidence->n_standing;
    if (owner == Owner::kOther) ++evidence->n_other;
  } else if (height_m >= range_.band_min_z_m && height_m <= range_.band_max_z_m) {
    ++evidence->n_floor;
  }
}

}  // namespace core_perception
