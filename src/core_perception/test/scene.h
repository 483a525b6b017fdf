// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/params.h"
#include "core_perception/predicates.h"

namespace core_perception {

/// An upright cylinder standing on (or hanging above) the floor z = 0.
struct Cylinder {
  std::string class_name;
  Point2 centre;
  double radius_m = 0.15;
  double bottom_m = 0.0, top_m = 0.7;
};

/// Floor and cylinders, rendered exactly by formula; the camera of the demo robot, 0.65 m up and
/// 0.25 rad down.
struct Scene {
  std::vector<Cylinder> cylinders;
  /// Height of uneven ground and of what lies on it, found to a millimetre; none: the plane z = 0.
  std::function<double(double x_m, double y_m)> ground;
  double ground_top_m = 0.0;  ///< the ground is nowhere higher
  Camera view = camera();

  static Camera camera() { return Camera{274.9, 376.7, 250.0, 160.0, 500, 320}; }

  Frame render(double stamp_s, double x_m, double y_m, double yaw_rad) const {
    return render(stamp_s, x_m, y_m, pose(x_m, y_m, yaw_rad));
  }

  Frame render(double stamp_s, double x_m, double y_m, const Pose& T_map_camera) const {
    Frame frame;
    frame.stamp_s = stamp_s;
    frame.camera = view;
    frame.p_map_base = {x_m, y_m};
    frame.T_map_camera = T_map_camera;
    frame.classes.push_back({1, "floor"});
    frame.classes_evaluated = {"floor"};
    for (size_t i = 0; i < cylinders.size(); ++i) {
      frame.classes.push_back({static_cast<uint16_t>(i + 2), cylinders[i].class_name});
      frame.classes_evaluated.push_back(cylinders[i].class_name);
    }
    const float nothing = std::numeric_limits<float>::quiet_NaN();
    frame.depth =
        cv::Mat(frame.camera.height_px, frame.camera.width_px, CV_32FC1, cv::Scalar(nothing));
    frame.labels = cv::Mat::zeros(frame.camera.height_px, frame.camera.width_px, CV_16UC1);
    for (int v = 0; v < frame.depth.rows; ++v) {
      for (int u = 0; u < frame.depth.cols; ++u) shade(u, v, &frame);
    }
    return frame;
  }

  static Eigen::Isometry3d pose(double x_m, double y_m, double yaw_rad) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.translate(Eigen::Vector3d(x_m, y_m, 0.52));
    T.rotate(Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()));
    T.translate(Eigen::Vector3d(0.5, 0.0, 0.13));
    T.rotate(Eigen::AngleAxisd(0.25, Eigen::Vector3d::UnitY()));
    Eigen::Matrix3d optical;  // columns: right, down, forward in x forward, y left, z up
    optical << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    T.rotate(optical);
    return T;
  }

 private:
  /// Smallest positive z-depth along the pixel's ray wins.
  void shade(int u, int v, Frame* frame) const {
    const Camera& c = frame->camera;
    const Eigen::Vector3d d =
        frame->T_map_camera.linear() *
        Eigen::Vector3d((u - c.cx_px) / c.fx_px, (v - c.cy_px) / c.fy_px, 1.0);
    const Eigen::Vector3d o = frame->T_map_camera.translation();
    double best = d.z() < 0.0 ? -o.z() / d.z() : std::numeric_limits<double>::infinity();
    if (ground) best = meetGround(o, d);
    uint16_t label = 1;
    for (size_t i = 0; i < cylinders.size(); ++i) {
      const double t = intersect(cylinders[i], o, d);
      if (t >= best) continue;
      best = t;
      label = static_cast<uint16_t>(i + 2);
    }
    if (!(best < 30.0)) return;
    frame->depth.at<float>(v, u) = static_cast<float>(best);
    frame->labels.at<uint16_t>(v, u) = label;
  }

  /// Ray parameter where a ray from above first goes below the ground, infinite for none near.
  double meetGround(const Eigen::Vector3d& o, const Eigen::Vector3d& d) const {
    constexpr double kStep = 0.02, kFarthest = 9.0;
    const auto isBelow = [&](double t) {
      return o.z() + t * d.z() < ground(o.x() + t * d.x(), o.y() + t * d.y());
    };
    if (o.z() > ground_top_m && d.z() >= 0.0) return std::numeric_limits<double>::infinity();
    double above = o.z() > ground_top_m ? (ground_top_m - o.z()) / d.z() : 0.0;
    double below = above;
    while (!isBelow(below)) {
      above = below;
      below += kStep;
      if (below > kFarthest) return std::numeric_limits<double>::infinity();
    }
    while (below - above > 1e-4) {
      const double middle = 0.5 * (above + below);
      (isBelow(middle) ? below : above) = middle;
    }
    return 0.5 * (above + below);
  }

  /// Ray parameter at the mantle or the lid, infinite for none.
  static double intersect(const Cylinder& c, const Eigen::Vector3d& o, const Eigen::Vector3d& d) {
    const double ox = o.x() - c.centre.x, oy = o.y() - c.centre.y;
    double best = std::numeric_limits<double>::infinity();
    const double qa = d.x() * d.x() + d.y() * d.y(), qb = ox * d.x() + oy * d.y();
    const double disc = qb * qb - qa * (ox * ox + oy * oy - c.radius_m * c.radius_m);
    if (disc < 0.0) return best;
    const double mantle = (-qb - std::sqrt(disc)) / qa;
    const double z = o.z() + mantle * d.z();
    if (mantle > 0.0 && z >= c.bottom_m && z <= c.top_m) best = mantle;
    for (const double lid_z : {c.bottom_m, c.top_m}) {
      const double lid = (lid_z - o.z()) / d.z();
      const double x = ox + lid * d.x(), y = oy + lid * d.y();
      if (lid > 0.0 && lid < best && x * x + y * y <= c.radius_m * c.radius_m) best = lid;
    }
    return best;
  }
};

/// Noise of a stereo camera of 50 mm baseline: sigma grows with the square of depth, to 6 cm at 7
/// m.
inline void addStereoNoise(std::mt19937* random, Frame* frame) {
  std::normal_distribution<float> normal;
  for (int v = 0; v < frame->depth.rows; ++v) {
    for (int u = 0; u < frame->depth.cols; ++u) {
      float& depth_m = frame->depth.at<float>(v, u);
      depth_m += 0.0012f * depth_m * depth_m * normal(*random);
    }
  }
}

inline Predicate makePredicate(SpatialOperator spatial_operator, const std::string& class_name,
                               Verdict verdict, double radius_m = 0.0) {
  Predicate predicate;
  predicate.spatial_operator = spatial_operator;
  predicate.class_name = class_name;
  predicate.verdict = verdict;
  predicate.radius_m = radius_m;
  return predicate;
}

/// ON(floor) safe, NEAR(traffic_cone) and BETWEEN(traffic_cone) unsafe.
inline Constraints makeConeRules() {
  Constraints constraints;
  constraints.image_stamp_s = 0.5;
  constraints.predicates = {
      makePredicate(SpatialOperator::kOn, "floor", Verdict::kSafe),
      makePredicate(SpatialOperator::kNear, "traffic_cone", Verdict::kUnsafe),
      makePredicate(SpatialOperator::kBetween, "traffic_cone", Verdict::kUnsafe)};
  return constraints;
}

/// Five cones across the way at x = 5 m, 1 m apart.
inline Scene makeConeLine() {
  Scene scene;
  for (int i = -2; i <= 2; ++i) scene.cylinders.push_back({"traffic_cone", {5.0, 1.0 * i}});
  return scene;
}

/// Profile paper, as config/paper.yaml has it.
inline SemanticMapParams makePaperParams() {
  SemanticMapParams p;
  p.operators = "image";
  p.unknown_is_unsafe = false;
  p.initial_disc_radius_m = 4.0;
  p.distance = "centre";
  p.range.range_min_m = 3.0;
  p.range.tree_min_z_m = p.range.band_min_z_m = -2.0;
  p.range.tree_max_z_m = p.range.band_max_z_m = 5.0;
  p.range.depth_edge_ratio = 0.0;
  p.vote.votes = "pixel";
  p.vote.column = "sum";
  p.vote.count_cap = 0;
  p.range.local_floor = false;
  p.vote.metric_layer = p.vote.free_space_clearing = false;
  p.vote.mobile_half_life_s = 0.0;
  p.instance.mobile_classes.clear();
  return p;
}

}  // namespace core_perception
