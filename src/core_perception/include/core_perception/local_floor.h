// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <vector>

#include "core_perception/floor_samples.h"

namespace core_perception {

/// What a frame showed of the floor of a column.
enum class FloorState : uint8_t {
  kAssumed,  ///< not seen; the height of the floor beside it
  kHeld,     ///< not seen now; what was seen before agrees with the floor around it
  kSeen,     ///< its lowest points are floor
  kRaised,   ///< its lowest points stand above the floor around it: the floor there is hidden
  kDrop      ///< its lowest points lie below the floor around it: the ground falls away
};

/// Height of the floor around the robot, in columns of kCell_m.
///
/// The floor of every frame is grown anew, outward from the ground the robot stands on and never
/// back towards it. A column joins with the height z of its third lowest sample when for every
/// column f of the floor within two columns and no farther from the robot
///
///     |z - z_f| <= max(0.9 metric_min_height_m, kGrade distance) + kNoise range
///
/// So a kerb of 0.08 m and a ramp are floor. What rises by metric_min_height_m near the robot never
/// is; nor do small steps add up that follow each other within two columns. Steps that are farther
/// apart, and slopes up to kGrade, are floor however high they lead. A column that is not flat has
/// to agree within kGrade distance: what stands in it may hide its own foot. Across what is not
/// floor the floor goes on level.
///
/// A column in view that does not join is no floor, and a point in it counts by the lowest floor
/// within kLowering_m: where in doubt the floor is low, and more counts as an obstacle. Ground that
/// falls away by more than the same limit does not join either. Within kHeldReach_m a column keeps
/// what was seen of it: out of view it is the ground that the robot then walks on, and in view it
/// rises by no more than kRisePerFrame_m, as when its foot leaves the image first. Other columns
/// take the floor of their neighbour towards the robot. The beginning is the disc around the
/// robot's first position, at floor_z_m.
///
/// Since every frame is measured by its own floor, an error of the camera's pitch cancels, constant
/// or not, and so does a height of the robot that drifts. While the robot stands, the ground below
/// it is out of view: then held heights follow what the floor near by has changed since, by at most
/// kDriftPerFrame_m a frame: the least of the median changes of the left, the middle and the right
/// third of the view, and none where these have different signs. What rises more slowly than that
/// and fills all of the near view would be followed.
///
/// Heights are above floor_z_m. Memory: 50 bytes a column within reach of the camera, however far
/// the robot walks. Differs from [CORE], which knows no floor.
class LocalFloor {
 public:
  /// @param initial_disc_radius_m of the ground that is known at the start.
  LocalFloor(const RangeParams& range, double initial_disc_radius_m);

  /// Finds the floor of a frame.
  /// @param metres depth as convertToMetres leaves it.
  void update(const cv::Mat& metres, const Projection& projection, const Point2& p_map_base);

  /// Takes the height of the floor from the points of a row of this frame: their heights above the
  /// camera become those above a camera over level floor.
  void level(PointRow* row) const;
  /// Height at a place above floor_z_m [m]; that at the border of the window for places outside it.
  float height_m(double x_m, double y_m) const;
  FloorState state(double x_m, double y_m) const;
  /// Columns of the window.
  size_t size() const { return height_.size(); }
  /// Forgets the floor. The next disc around the robot is laid as far below the camera as that at
  /// the first position, wherever the robot has climbed since and whatever its height has drifted.
  void clear();

  static constexpr double kCell_m = 0.2;
  static constexpr float kGrade = 0.20f;              ///< of a ramp [m/m]
  static constexpr float kNoise = 0.003f;             ///< growth of a column's error with range
  static constexpr float kLowering_m = 0.6f;          ///< see above
  static constexpr float kHeldReach_m = 3.0f;         ///< farther off an error of pitch spoils it
  static constexpr float kRisePerFrame_m = 0.002f;    ///< of floor that was seen before
  static constexpr float kDriftPerFrame_m = 0.0005f;  ///< 0.3 m a minute at 10 Hz

 private:
  /// A column near another one.
  struct Neighbour {
    int offset;
    float step_m, tight_m;  ///< largest difference of height, of a flat column and of another
    bool adjacent;          ///< one of the eight
  };
  /// What the floor near a column allows its height to be.
  struct Bounds {
    float low_m = -std::numeric_limits<float>::infinity();
    float high_m = std::numeric_limits<float>::infinity();
    float tight_low_m = low_m, tight_high_m = high_m;  ///< if it is not flat
    float lowest_m = high_m;                           ///< of the floor right beside it

    bool holds(float z_m, float noise_m) const {
      return z_m >= low_m - noise_m && z_m <= high_m + noise_m;
    }
    /// Of a column that is not flat.
    Bounds tighten() const {
      Bounds tight = *this;
      tight.low_m = tight_low_m;
      tight.high_m = tight_high_m;
      return tight;
    }
    void add(float floor_m, float step_m, float tight_m) {
      low_m = std::max(low_m, floor_m - step_m);
      high_m = std::min(high_m, floor_m + step_m);
      tight_low_m = std::max(tight_low_m, floor_m - tight_m);
      tight_high_m = std::min(tight_high_m, floor_m + tight_m);
    }
  };

  int indexOf(double x_m, double y_m) const;
  void moveWindow(const Projection& projection, const Point2& p_map_base);
  void layOut(int reach);
  void holdDisc(const Point2& p_map_base, float camera_height_m);
  void grow();
  void growColumn(int cell, float range_m);
  Bounds findBounds(int cell) const;
  void join(int cell, float z_m, const Bounds& bounds);
  void lower();
  void followDrift(const Projection& projection);
  float measureChange(const Projection& projection);

  double radius_m_;
  float step_m_;
  FloorSamples samples_;
  // The window.
  int width_ = 0;
  CellIndex origin_{0, 0};
  std::vector<int> order_;      ///< columns by distance from the camera
  std::vector<float> range_m_;  ///< that distance, by column
  std::vector<int> inner_;      ///< neighbour of a column towards the camera
  std::vector<Neighbour> near_;
  // By column.
  std::vector<float> held_;    ///< floor seen before; NaN for none
  std::vector<float> floor_;   ///< found, else assumed
  std::vector<float> level_;   ///< at which it goes on where nothing is known
  std::vector<float> height_;  ///< given out
  std::vector<FloorState> state_;
  std::vector<uint8_t> is_ground_;  ///< whether the floor here is known, not assumed
  // While the robot stands.
  std::vector<float> anchor_;        ///< what was held when it stopped
  float followed_m_ = 0.0f;          ///< change since then that held heights have followed
  std::vector<float> changes_m_[3];  ///< left, in the middle and right
  bool has_disc_ = false;
  /// Of the camera above floor_z_m in the first frame.
  float first_height_m_ = std::numeric_limits<float>::quiet_NaN();
  float camera_x_ = 0.0f, camera_y_ = 0.0f;  ///< in columns, from the corner of the window
  mutable std::vector<int32_t> columns_;     ///< of the points of a row
  Eigen::Vector3d p_last_camera_ = Eigen::Vector3d::Zero();
};

}  // namespace core_perception
