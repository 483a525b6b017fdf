// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>
#include <random>

#include "core_perception/spatial_operators.h"
#include "scene.h"

namespace core_perception {
namespace {

bool equal(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::countNonZero(a != b) == 0;
}

/// Blobs, specks or nothing, at widths about a multiple of 16 and at the image border.
cv::Mat makeRandomMask(std::mt19937* random, int width, int height) {
  cv::Mat mask = cv::Mat::zeros(height, width, CV_8UC1);
  const int n = static_cast<int>((*random)() % 6);
  for (int i = 0; i < n; ++i) {
    const cv::Point centre(static_cast<int>((*random)() % width),
                           static_cast<int>((*random)() % height));
    const int radius = static_cast<int>((*random)() % 30);
    cv::circle(mask, centre, radius, cv::Scalar(255), (*random)() % 2 == 0 ? -1 : 1);
  }
  return mask;
}

cv::Mat dilatePlainly(const cv::Mat& mask, int kernel_px) {
  cv::Mat out;
  cv::dilate(mask, out,
             cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(kernel_px, kernel_px)));
  return out;
}

cv::Mat fillPlainly(const cv::Mat& mask) {
  cv::Mat out = cv::Mat::zeros(mask.size(), CV_8UC1);
  std::vector<cv::Point> points, hull;
  cv::findNonZero(mask, points);
  if (points.empty()) return out;
  cv::convexHull(points, hull);
  cv::fillConvexPoly(out, hull, cv::Scalar(255));
  return out;
}

cv::Mat toMask(const PixelSet& set) {
  cv::Mat mask = cv::Mat::zeros(set.height(), set.width(), CV_8UC1);
  set.paint(255, &mask);
  return mask;
}

cv::Mat computeRegions(const cv::Mat& labels, const std::vector<LabelClass>& classes,
                       const std::vector<Predicate>& predicates) {
  ImageRegions regions(50);
  LabelRuns runs;
  runs.build(labels);
  regions.compute(runs, classes, predicates);
  return regions.image().clone();
}

TEST(SpatialOperators, are_bit_equal_to_plain_opencv) {
  std::mt19937 random(3);
  for (int round = 0; round < 1200; ++round) {
    const int width = 497 + round % 16;
    cv::Mat mask = makeRandomMask(&random, width, 100 + static_cast<int>(random() % 60));
    const int kernel_px = round % 4 == 0 ? 1 + static_cast<int>(random() % 60) : 50;
    if (round % 5 == 0) {  // a mask full of holes
      cv::Mat noise(mask.size(), CV_8UC1);
      cv::randu(noise, 0, 256);
      mask &= noise < 64 + 16 * (round % 10);
    }
    ASSERT_TRUE(equal(toMask(findPixels(mask)), mask)) << round;
    ASSERT_TRUE(
        equal(toMask(dilateAround(findPixels(mask), kernel_px)), dilatePlainly(mask, kernel_px)))
        << round << " " << kernel_px;
    ASSERT_TRUE(equal(toMask(fillBetween(findPixels(mask))), fillPlainly(mask))) << round;
  }
}

TEST(SpatialOperators, a_class_is_every_label_of_it_and_never_label_0) {
  cv::Mat labels = (cv::Mat_<uint16_t>(1, 5) << 0, 1, 2, 65535, 3);
  const std::vector<LabelClass> classes{{0, "cone"}, {1, "cone"}, {65535, "cone"}, {2, "box"}};
  const auto find = [&](const std::string& name) {
    return computeRegions(labels, classes,
                          {makePredicate(SpatialOperator::kNear, name, Verdict::kSafe)});
  };
  EXPECT_TRUE(equal(find("cone"), (cv::Mat_<uint8_t>(1, 5) << 0, 255, 0, 255, 0)));
  EXPECT_EQ(cv::countNonZero(find("chair")), 0);
}

TEST(SpatialOperators, last_unsafe_predicate_that_holds_is_named_as_far_as_numbers_go) {
  const cv::Mat labels = cv::Mat::ones(1, 1, CV_16UC1);
  std::vector<Predicate> predicates;
  for (int i = 0; i < 300; ++i) {
    predicates.push_back(makePredicate(SpatialOperator::kNear, "box", Verdict::kUnsafe));
    predicates.push_back(makePredicate(SpatialOperator::kNear, "box", Verdict::kSafe));
    const int region = computeRegions(labels, {{1, "box"}}, predicates).at<uint8_t>(0, 0);
    ASSERT_EQ(region, std::min(2 * i + 1, 254));
  }
}

TEST(SpatialOperators, safe_set_is_union_of_safe_minus_union_of_unsafe) {
  std::mt19937 random(4);
  const std::vector<LabelClass> classes{{1, "floor"}, {2, "rug"}, {3, "cone"}, {4, "box"}};
  const std::vector<Predicate> predicates{
      makePredicate(SpatialOperator::kOn, "floor", Verdict::kSafe),
      makePredicate(SpatialOperator::kAround, "rug", Verdict::kSafe),
      makePredicate(SpatialOperator::kAround, "cone", Verdict::kUnsafe),
      makePredicate(SpatialOperator::kBetween, "cone", Verdict::kUnsafe),
      makePredicate(SpatialOperator::kNear, "box", Verdict::kUnsafe)};
  for (int round = 0; round < 20; ++round) {
    cv::Mat labels = cv::Mat::ones(120, 200, CV_16UC1);
    for (int label = 2; label <= 4; ++label) labels.setTo(label, makeRandomMask(&random, 200, 120));
    const cv::Mat regions = computeRegions(labels, classes, predicates);
    const auto mask = [&](int label) -> cv::Mat { return labels == label; };
    const cv::Mat safe = mask(1) | dilatePlainly(mask(2), 50);
    const cv::Mat unsafe = dilatePlainly(mask(3), 50) | fillPlainly(mask(3)) | mask(4);
    EXPECT_TRUE(equal(regions == kSafeRegion, safe & ~unsafe));
    EXPECT_TRUE(equal((regions > 0) & (regions < kSafeRegion), unsafe));
  }
}

TEST(SpatialOperators, no_predicate_makes_nothing_safe) {
  const cv::Mat labels = cv::Mat::ones(10, 10, CV_16UC1);
  EXPECT_EQ(cv::countNonZero(computeRegions(labels, {{1, "floor"}}, {})), 0);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
