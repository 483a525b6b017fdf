// SPDX-License-Identifier: BSD-3-Clause
#include "image_masks.h"

#include <opencv2/imgproc.hpp>

namespace core_perception {
namespace bench {
namespace {

cv::Mat drawClass(const Frame& frame, const std::string& class_name) {
  cv::Mat mask = cv::Mat::zeros(frame.labels.size(), CV_8UC1), one;
  for (const LabelClass& label : frame.classes) {
    if (label.class_name != class_name) continue;
    cv::inRange(frame.labels, cv::Scalar(label.id), cv::Scalar(label.id), one);
    cv::bitwise_or(mask, one, mask);
  }
  return mask;
}

cv::Mat drawHull(const cv::Mat& mask) {
  cv::Mat filled = cv::Mat::zeros(mask.size(), CV_8UC1);
  std::vector<cv::Point> points, hull;
  cv::findNonZero(mask, points);
  if (points.empty()) return filled;
  cv::convexHull(points, hull);
  cv::fillConvexPoly(filled, hull, cv::Scalar(255));
  return filled;
}

cv::Mat drawPredicate(const Frame& frame, const Predicate& predicate, int kernel_px) {
  cv::Mat mask = drawClass(frame, predicate.class_name);
  if (predicate.spatial_operator == SpatialOperator::kBetween) return drawHull(mask);
  if (predicate.spatial_operator != SpatialOperator::kAround) return mask;
  cv::Mat grown;
  cv::dilate(mask, grown,
             cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(kernel_px, kernel_px)));
  return grown;
}

}  // namespace

cv::Mat drawSafeMask(const Frame& frame, const std::vector<Predicate>& predicates, int kernel_px) {
  cv::Mat safe = cv::Mat::zeros(frame.labels.size(), CV_8UC1);
  cv::Mat unsafe = cv::Mat::zeros(frame.labels.size(), CV_8UC1);
  for (const Predicate& predicate : predicates) {
    cv::Mat& set = predicate.isUnsafe() ? unsafe : safe;
    cv::bitwise_or(set, drawPredicate(frame, predicate, kernel_px), set);
  }
  safe.setTo(cv::Scalar(0), unsafe);
  return safe;
}

}  // namespace bench
}  // namespace core_perception
