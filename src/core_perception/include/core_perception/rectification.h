// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "core_perception/frame.h"

namespace core_perception {

/// Distortion of a lens, with x, y the undistorted ray (x/z, y/z) and r^2 = x^2 + y^2:
///
///     s  = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
///     x' = s x + 2 p1 x y + p2 (r^2 + 2 x^2)
///     y' = s y + p1 (r^2 + 2 y^2) + 2 p2 x y          pixel = (fx x' + cx, fy y' + cy)
///
/// Source: sensor_msgs/CameraInfo, plumb_bob (k4..k6 = 0) and rational_polynomial.
struct Distortion {
  double k1 = 0.0, k2 = 0.0, p1 = 0.0, p2 = 0.0, k3 = 0.0, k4 = 0.0, k5 = 0.0, k6 = 0.0;

  bool isNone() const;
};

bool operator==(const Distortion& a, const Distortion& b);

/// Turns images of a lens into those of a pinhole camera of the same intrinsics. The nearest pixel
/// is taken: neither depths nor labels may be mixed. A pixel whose ray the image does not show, or
/// for which the polynomial no longer rises (it then folds back into the image), becomes 0.
class Rectifier {
 public:
  /// @param image CV_32FC1 or CV_16UC1 of the camera's size. @returns a new image.
  /// The table is made again only when camera or lens change.
  cv::Mat rectify(const Camera& camera, const Distortion& lens, const cv::Mat& image);

 private:
  void buildTable(const Camera& camera, const Distortion& lens);

  Camera camera_;
  Distortion lens_;
  std::vector<int32_t> source_;  ///< pixel of the raw image for each of the new one, -1 for none
};

}  // namespace core_perception
