// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "core_perception/geometry2d.h"

namespace core_perception {

/// Cell of the fixed frame: floor(coordinate / resolution).
struct CellIndex {
  int x, y;
};
inline bool operator<(const CellIndex& a, const CellIndex& b) {
  return a.x < b.x || (a.x == b.x && a.y < b.y);
}
inline bool operator==(const CellIndex& a, const CellIndex& b) { return a.x == b.x && a.y == b.y; }

/// One object as one frame saw it.
struct Detection {
  std::string class_name;
  Polygon footprint;                    ///< convex hull of its ground points [m], fixed frame
  std::vector<CellIndex> cells;         ///< map cells it touches, sorted
  double z_min_m = 0.0, z_max_m = 0.0;  ///< as if the local floor were at floor_z_m
  uint32_t n_points = 0;
};

/// Splits the labelled points of one frame into objects.
///
/// The points of a label are binned on the ground in cells of 5 cm. Bins of one label farther than
/// about 0.25 m apart are taken as different objects: a segmenter may give several objects one
/// label, and pixels of a label that bled onto the background land far behind the object. Groups
/// with fewer than min_points points are dropped. Of an object that stands up, floor-level points
/// count only within one bin of standing ones: those farther off are floor that got its label.
class InstanceDetector {
 public:
  InstanceDetector(double map_resolution_m, int min_points);

  /// Empties it and moves it around a camera of this reach.
  void start(const Eigen::Vector3d& p_map_camera, double reach_m);
  /// @param slot index of the label's class in the frame.
  /// @param d_m point relative to the camera along the axes of the fixed frame, within reach.
  /// @param standing whether it lies above the floor by more than the metric band's lower end.
  void add(int16_t slot, const Eigen::Vector3f& d_m, bool standing) {
    constexpr auto kBinsPerMetre = static_cast<float>(1.0 / kBin_m);
    // Within reach neither is negative, so that the conversion is floor().
    const int x = static_cast<int>(offset_x_ + d_m.x() * kBinsPerMetre);
    const int y = static_cast<int>(offset_y_ + d_m.y() * kBinsPerMetre);
    if (x < 0 || y < 0 || x >= width_ || y >= width_) return;  // a pose that stretches a little
    Bin& bin = touchBin(slot, x, y);
    bin.z_min_m = std::min(bin.z_min_m, d_m.z());
    bin.z_max_m = std::max(bin.z_max_m, d_m.z());
    bin.sum_x_m += d_m.x();
    bin.sum_y_m += d_m.y();
    ++bin.n_points;
    bin.n_standing += standing ? 1 : 0;
  }
  /// @param class_names class per slot.
  std::vector<Detection> finish(const std::vector<std::string>& class_names) const;

 private:
  static constexpr double kBin_m = 0.05;
  struct Bin {
    int16_t slot = 0;
    int x = 0, y = 0;   ///< indices in the square of bins around the camera
    int32_t next = -1;  ///< bin of another slot at the same place
    uint32_t n_points = 0, n_standing = 0;
    double sum_x_m = 0.0, sum_y_m = 0.0;  ///< relative to the camera
    float z_min_m = std::numeric_limits<float>::infinity();
    float z_max_m = -std::numeric_limits<float>::infinity();
  };
  using Bins = std::vector<const Bin*>;

  size_t cellOf(int x, int y) const { return static_cast<size_t>(y) * width_ + x; }
  const Bin* find(int16_t slot, int x, int y) const;
  Bin& touchBin(int16_t slot, int x, int y) {
    const int32_t head = heads_[cellOf(x, y)];
    for (int32_t i = head; i >= 0; i = bins_[i].next) {
      if (bins_[i].slot == slot) return bins_[i];
    }
    return addBin(slot, x, y);
  }
  Bin& addBin(int16_t slot, int x, int y);
  static std::vector<Point2> findRim(const std::vector<Point2>& means, const Bins& bins);
  Bins keepStanding(const Bins& bins) const;
  void splitSlot(const Bins& bins, const std::string& class_name,
                 std::vector<Detection>* detections) const;
  void appendDetection(const Bins& bins, const std::string& class_name,
                       std::vector<Detection>* detections) const;

  double map_resolution_m_;
  uint32_t min_points_;
  Eigen::Vector3d p_map_camera_ = Eigen::Vector3d::Zero();
  int width_ = 0;                            ///< bins along the edge of the square
  float offset_x_ = 0.0f, offset_y_ = 0.0f;  ///< camera in bins, from the square's corner
  std::vector<Bin> bins_;
  std::vector<int32_t> heads_;  ///< first bin of every place, -1 for none
};

}  // namespace core_perception
