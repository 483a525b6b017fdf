// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "core_perception/rectification.h"

namespace core_perception {
namespace {

const Camera kCamera{180.0, 175.0, 158.3, 121.7, 320, 240};

struct Ray {
  double x, y;
};

/// What CameraInfo says of the two models, written out.
Ray distort(const Distortion& d, const Ray& ray) {
  const double x = ray.x, y = ray.y, r2 = x * x + y * y, r4 = r2 * r2, r6 = r4 * r2;
  const double s =
      (1 + d.k1 * r2 + d.k2 * r4 + d.k3 * r6) / (1 + d.k4 * r2 + d.k5 * r4 + d.k6 * r6);
  return {x * s + 2 * d.p1 * x * y + d.p2 * (r2 + 2 * x * x),
          y * s + d.p1 * (r2 + 2 * y * y) + 2 * d.p2 * x * y};
}

/// The ray that a pixel of the raw image shows, by Newton's method.
Ray findRay(const Distortion& d, double u, double v) {
  const Ray wanted{(u - kCamera.cx_px) / kCamera.fx_px, (v - kCamera.cy_px) / kCamera.fy_px};
  Ray ray = wanted;
  for (int i = 0; i < 50; ++i) {
    const double e = 1e-6;
    const Ray at = distort(d, ray), dx = distort(d, {ray.x + e, ray.y}),
              dy = distort(d, {ray.x, ray.y + e});
    const double a = (dx.x - at.x) / e, b = (dy.x - at.x) / e, c = (dx.y - at.y) / e,
                 f = (dy.y - at.y) / e, det = a * f - b * c;
    const double ex = wanted.x - at.x, ey = wanted.y - at.y;
    ray.x += (f * ex - b * ey) / det;
    ray.y += (a * ey - c * ex) / det;
  }
  return ray;
}

/// A slanted plane: z-depth along a ray; further to the right it is farther.
double depthAt(const Ray& ray) { return 3.0 / (1.0 - 0.4 * ray.x - 0.2 * ray.y); }
/// Stripes of a tenth of a radian or so.
int labelAt(const Ray& ray) { return 1 + static_cast<int>(std::floor(ray.x * 10.0 + 50.0)); }

struct Images {
  cv::Mat depth, labels;
};

Images renderRaw(const Distortion& d) {
  Images images{cv::Mat(kCamera.height_px, kCamera.width_px, CV_32FC1),
                cv::Mat(kCamera.height_px, kCamera.width_px, CV_16UC1)};
  for (int v = 0; v < kCamera.height_px; ++v) {
    for (int u = 0; u < kCamera.width_px; ++u) {
      const Ray ray = findRay(d, u, v);
      images.depth.at<float>(v, u) = static_cast<float>(depthAt(ray));
      images.labels.at<uint16_t>(v, u) = static_cast<uint16_t>(labelAt(ray));
    }
  }
  return images;
}

Ray pinholeRay(double u, double v) {
  return {(u - kCamera.cx_px) / kCamera.fx_px, (v - kCamera.cy_px) / kCamera.fy_px};
}

class RectificationTest : public testing::TestWithParam<Distortion> {};

TEST_P(RectificationTest, a_distorted_picture_becomes_that_of_a_pinhole_camera) {
  const Images raw = renderRaw(GetParam());
  Rectifier rectifier;
  const cv::Mat depth = rectifier.rectify(kCamera, GetParam(), raw.depth);
  const cv::Mat labels = rectifier.rectify(kCamera, GetParam(), raw.labels);
  int n_shown = 0, n_moved = 0;
  for (int v = 0; v < kCamera.height_px; ++v) {
    for (int u = 0; u < kCamera.width_px; ++u) {
      const float z = depth.at<float>(v, u);
      ASSERT_EQ(z == 0.0f, labels.at<uint16_t>(v, u) == 0) << u << " " << v;
      if (z == 0.0f) continue;
      ++n_shown;
      const Ray ray = pinholeRay(u, v);
      const double expected = depthAt(ray);
      // The nearest pixel is half a pixel off at most in the raw image, here below 1.1 pixels.
      const double slope = expected * expected / 3.0 * (0.4 / kCamera.fx_px + 0.2 / kCamera.fy_px);
      ASSERT_NEAR(z, expected, 1.1 * slope) << u << " " << v;
      const int left = labelAt(pinholeRay(u - 1.1, v)), right = labelAt(pinholeRay(u + 1.1, v));
      ASSERT_GE(labels.at<uint16_t>(v, u), left) << u << " " << v;
      ASSERT_LE(labels.at<uint16_t>(v, u), right) << u << " " << v;
      if (std::abs(raw.depth.at<float>(v, u) - expected) > 3.0 * slope) ++n_moved;
    }
  }
  EXPECT_GT(n_shown, kCamera.width_px * kCamera.height_px * 7 / 10);
  EXPECT_GT(n_moved, 1000) << "the lens is too good to show anything";
}

INSTANTIATE_TEST_SUITE_P(Lenses, RectificationTest,
                         testing::Values(Distortion{-0.12, 0.02, 0.003, -0.002, -0.001, 0, 0, 0},
                                         Distortion{0.08, -0.01, -0.002, 0.001, 0, 0, 0, 0},
                                         Distortion{0.45, 0.12, 0.001, 0.0004, 0.01, 0.6, 0.1,
                                                    0.02}));

TEST(Rectification, no_value_is_mixed_of_two) {
  const Distortion lens{-0.2, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  cv::Mat image(kCamera.height_px, kCamera.width_px, CV_16UC1);
  for (int i = 0; i < image.rows * image.cols; ++i)
    image.at<uint16_t>(i / image.cols, i % image.cols) = i % 2 == 0 ? 7 : 60000;
  const cv::Mat result = Rectifier().rectify(kCamera, lens, image);
  const std::set<uint16_t> values(result.begin<uint16_t>(), result.end<uint16_t>());
  EXPECT_TRUE(values == (std::set<uint16_t>{7, 60000}) ||
              values == (std::set<uint16_t>{0, 7, 60000}));
}

TEST(Rectification, rays_beyond_the_turn_of_the_polynomial_are_not_shown) {
  // r (1 - 0.9 r^2) rises up to r = 0.61; farther rays fold back into the image.
  const Distortion lens{-0.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  cv::Mat image(kCamera.height_px, kCamera.width_px, CV_16UC1);
  image.setTo(5);
  const cv::Mat result = Rectifier().rectify(kCamera, lens, image);
  for (int v = 0; v < result.rows; v += 3) {
    for (int u = 0; u < result.cols; u += 3) {
      const Ray ray = pinholeRay(u, v);
      const double r = std::hypot(ray.x, ray.y);
      if (std::abs(r - std::sqrt(1.0 / 2.7)) < 0.01) continue;
      ASSERT_EQ(result.at<uint16_t>(v, u), r < std::sqrt(1.0 / 2.7) ? 5 : 0) << u << " " << v;
    }
  }
}

TEST(Rectification, another_camera_or_lens_makes_another_table) {
  const Distortion lens{-0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  const cv::Mat image = renderRaw(Distortion()).depth;
  Rectifier rectifier;
  const cv::Mat first = rectifier.rectify(kCamera, lens, image);
  EXPECT_EQ(cv::countNonZero(rectifier.rectify(kCamera, Distortion(), image) != image), 0);
  Camera shifted = kCamera;
  shifted.cx_px += 20.0;
  EXPECT_GT(cv::countNonZero(rectifier.rectify(shifted, lens, image) != first), 1000);
  EXPECT_EQ(cv::countNonZero(rectifier.rectify(kCamera, lens, image) != first), 0);
  Camera smaller = kCamera;
  smaller.width_px = 100;
  smaller.height_px = 50;
  const cv::Mat part = image(cv::Rect(0, 0, 100, 50)).clone();
  EXPECT_EQ(rectifier.rectify(smaller, lens, part).size(), part.size());
}

TEST(Rectification, distortion_that_is_no_number_shows_nothing) {
  const Distortion lens{std::nan(""), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  EXPECT_EQ(cv::countNonZero(Rectifier().rectify(kCamera, lens, renderRaw(Distortion()).depth)), 0);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
