// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core_perception/signed_distance.h"

namespace core_perception {
namespace {

constexpr double kResolution_m = 0.2;

/// Definition, cell by cell, over a grid with one ring of outside cells where those are unsafe.
double measurePlainly(const Mask& mask, int x, int y, DistanceConvention convention) {
  const bool unsafe = mask.unsafe[y * mask.width + x] != 0;
  const double half = convention == DistanceConvention::kBorder ? 0.5 : 0.0;
  double best = std::hypot(mask.width, mask.height);
  for (int j = -1; j <= mask.height; ++j) {
    for (int i = -1; i <= mask.width; ++i) {
      const bool outside = i < 0 || j < 0 || i == mask.width || j == mask.height;
      const bool other_unsafe =
          outside ? mask.outside_unsafe : mask.unsafe[j * mask.width + i] != 0;
      if (other_unsafe == unsafe || (outside && !mask.outside_unsafe)) continue;
      const double dx = std::max(0.0, std::abs(i - x) - half),
                   dy = std::max(0.0, std::abs(j - y) - half);
      best = std::min(best, std::hypot(dx, dy));
    }
  }
  return (unsafe ? -best : best) * kResolution_m;
}

void compare(const Mask& mask) {
  for (const DistanceConvention convention :
       {DistanceConvention::kBorder, DistanceConvention::kCentre}) {
    const std::vector<float> h = computeSignedDistance(mask, kResolution_m, convention);
    for (int y = 0; y < mask.height; ++y) {
      for (int x = 0; x < mask.width; ++x) {
        ASSERT_NEAR(h[y * mask.width + x], measurePlainly(mask, x, y, convention), 1e-5)
            << x << " " << y;
      }
    }
  }
}

TEST(SignedDistance, agrees_with_brute_force_on_random_grids) {
  std::mt19937 random(9);
  for (int round = 0; round < 60; ++round) {
    Mask mask;
    mask.width = 1 + static_cast<int>(random() % 40);
    mask.height = 1 + static_cast<int>(random() % 40);
    mask.outside_unsafe = random() % 2 == 0;
    const unsigned rarity = 1 + random() % 50;
    for (int i = 0; i < mask.width * mask.height; ++i)
      mask.unsafe.push_back(random() % rarity == 0 ? 1 : 0);
    compare(mask);
  }
}

TEST(SignedDistance, grids_of_one_kind_are_finite) {
  for (const uint8_t value : {0, 1}) {
    Mask mask;
    mask.width = 5;
    mask.height = 4;
    mask.unsafe.assign(20, value);
    compare(mask);
    mask.outside_unsafe = false;
    compare(mask);
  }
}

TEST(SignedDistance, border_convention_crosses_zero_at_the_border) {
  Mask mask;
  mask.width = 2;
  mask.height = 1;
  mask.outside_unsafe = false;
  mask.unsafe = {0, 1};
  const std::vector<float> h =
      computeSignedDistance(mask, kResolution_m, DistanceConvention::kBorder);
  EXPECT_FLOAT_EQ(h[0], 0.1f);
  EXPECT_FLOAT_EQ(h[1], -0.1f);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
