// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <limits>
#include <opencv2/core.hpp>
#include <vector>

#include "core_perception/instance_detector.h"
#include "core_perception/params.h"
#include "core_perception/projection.h"

namespace core_perception {

/// Heights of the samples of a column above floor_z_m [m]; infinite where there are not as many.
struct ColumnSamples {
  /// The three lowest: one or two may be mixed pixels or reflections.
  float first = std::numeric_limits<float>::infinity(), second = first, third = first;
  float highest = -first;  ///< of those below the height of the robot, on a ramp too

  bool isSeen() const { return third < std::numeric_limits<float>::infinity(); }
};

/// How low and how high the points of a frame reach in every column, from as few pixels as tell:
/// about 30 000 of an image of 500 x 320.
class FloorSamples {
 public:
  /// @param cell_m edge of a column.
  /// @param grade steepest ramp [m/m].
  FloorSamples(double cell_m, const RangeParams& range, float grade);

  /// @param metres depth as convertToMetres leaves it.
  /// @param origin first column of a square window that holds the reach of the camera.
  /// @param floor_m height of the floor below the camera, above floor_z_m.
  void collect(const cv::Mat& metres, const Projection& projection, CellIndex origin, int width,
               float floor_m);
  /// @param column row-major index in the window.
  const ColumnSamples& operator[](int column) const { return columns_[column]; }

 private:
  void collectRow(const cv::Mat& metres, const Projection& projection, int v, int step_px);

  double cell_m_;
  float range_max_m_, band_max_m_, grade_;
  CellIndex origin_{0, 0};
  int width_ = 0;
  float top_m_ = 0.0f;  ///< of what counts as highest, at the camera
  PointRow row_;
  std::vector<ColumnSamples> columns_;
};

}  // namespace core_perception
