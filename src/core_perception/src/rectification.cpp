// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/rectification.h"

#include <cmath>

namespace core_perception {
namespace {

double scaleAt(const Distortion& d, double r2) {
  return (1.0 + r2 * (d.k1 + r2 * (d.k2 + r2 * d.k3))) /
         (1.0 + r2 * (d.k4 + r2 * (d.k5 + r2 * d.k6)));
}

/// Radius up to which the distorted radius r s(r) rises; searched up to a ray of 80 degrees.
double findLargestRadius(const Distortion& d) {
  constexpr double kStep = 0.005, kLargest = 5.7;
  double before = 0.0;
  for (double r = kStep; r < kLargest; r += kStep) {
    const double now = r * scaleAt(d, r * r);
    if (!(now > before)) return r - kStep;
    before = now;
  }
  return kLargest;
}

bool isEqual(const Camera& a, const Camera& b) {
  return a.fx_px == b.fx_px && a.fy_px == b.fy_px && a.cx_px == b.cx_px && a.cy_px == b.cy_px &&
         a.width_px == b.width_px && a.height_px == b.height_px;
}

template <typename Pixel>
cv::Mat gather(const cv::Mat& image, const std::vector<int32_t>& source) {
  cv::Mat result(image.rows, image.cols, image.type());
  size_t i = 0;
  for (int v = 0; v < image.rows; ++v) {
    Pixel* out = result.ptr<Pixel>(v);
    for (int u = 0; u < image.cols; ++u, ++i) {
      const int from = source[i];
      out[u] = from < 0 ? Pixel(0) : image.ptr<Pixel>(from / image.cols)[from % image.cols];
    }
  }
  return result;
}

}  // namespace

bool Distortion::isNone() const { return *this == Distortion(); }

bool operator==(const Distortion& a, const Distortion& b) {
  return a.k1 == b.k1 && a.k2 == b.k2 && a.p1 == b.p1 && a.p2 == b.p2 && a.k3 == b.k3 &&
         a.k4 == b.k4 && a.k5 == b.k5 && a.k6 == b.k6;
}

cv::Mat Rectifier::rectify(const Camera& camera, const Distortion& lens, const cv::Mat& image) {
  if (source_.empty() || !isEqual(camera, camera_) || !(lens == lens_)) buildTable(camera, lens);
  return image.type() == CV_32FC1 ? gather<float>(image, source_)
                                  : gather<uint16_t>(image, source_);
}

void Rectifier::buildTable(const Camera& camera, const Distortion& lens) {
  camera_ = camera;
  lens_ = lens;
  source_.assign(static_cast<size_t>(camera.width_px) * camera.height_px, -1);
  const double largest = findLargestRadius(lens);
  size_t i = 0;
  for (int v = 0; v < camera.height_px; ++v) {
    const double y = (v - camera.cy_px) / camera.fy_px;
    for (int u = 0; u < camera.width_px; ++u, ++i) {
      const double x = (u - camera.cx_px) / camera.fx_px, r2 = x * x + y * y;
      if (!(r2 <= largest * largest)) continue;
      const double s = scaleAt(lens, r2);
      const double xd = s * x + 2.0 * lens.p1 * x * y + lens.p2 * (r2 + 2.0 * x * x);
      const double yd = s * y + lens.p1 * (r2 + 2.0 * y * y) + 2.0 * lens.p2 * x * y;
      const double ud = std::floor(camera.fx_px * xd + camera.cx_px + 0.5);
      const double vd = std::floor(camera.fy_px * yd + camera.cy_px + 0.5);
      // Written so that NaN fails.
      if (!(ud >= 0.0 && ud < camera.width_px && vd >= 0.0 && vd < camera.height_px)) continue;
      source_[i] = static_cast<int32_t>(vd) * camera.width_px + static_cast<int32_t>(ud);
    }
  }
}

}  // namespace core_perception
