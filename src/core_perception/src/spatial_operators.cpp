// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/spatial_operators.h"

#include <algorithm>
#include <opencv2/imgproc.hpp>

namespace core_perception {
namespace {

/// First and last set pixel of every row that has one.
std::vector<cv::Point> findRowExtremes(const cv::Mat& mask) {
  std::vector<cv::Point> points;
  for (int v = 0; v < mask.rows; ++v) {
    const uint8_t* begin = mask.ptr<uint8_t>(v);
    const uint8_t* end = begin + mask.cols;
    const auto is_set = [](uint8_t pixel) { return pixel != 0; };
    const uint8_t* first = std::find_if(begin, end, is_set);
    if (first == end) continue;
    const uint8_t* last = end - 1;
    while (*last == 0) --last;
    points.emplace_back(static_cast<int>(first - begin), v);
    if (last != first) points.emplace_back(static_cast<int>(last - begin), v);
  }
  return points;
}

}  // namespace

cv::Mat selectClass(const cv::Mat& labels, const std::vector<LabelClass>& classes,
                    const std::string& class_name) {
  std::vector<uint8_t> lut(65536, 0);
  for (const LabelClass& label : classes) {
    if (label.class_name == class_name && label.id != 0) lut[label.id] = 255;
  }
  cv::Mat mask(labels.rows, labels.cols, CV_8UC1);
  for (int v = 0; v < labels.rows; ++v) {
    const uint16_t* in = labels.ptr<uint16_t>(v);
    uint8_t* out = mask.ptr<uint8_t>(v);
    for (int u = 0; u < labels.cols; ++u) out[u] = lut[in[u]];
  }
  return mask;
}

cv::Mat dilateAround(const cv::Mat& mask, int kernel_px) {
  cv::Mat result = cv::Mat::zeros(mask.rows, mask.cols, CV_8UC1);
  const std::vector<cv::Point> extremes = findRowExtremes(mask);
  if (extremes.empty()) return result;
  // Nothing farther than the kernel from the box of the mask can change.
  cv::Rect box = cv::boundingRect(extremes);
  box -= cv::Point(kernel_px, kernel_px);
  box += cv::Size(2 * kernel_px, 2 * kernel_px);
  box &= cv::Rect(0, 0, mask.cols, mask.rows);
  const cv::Mat kernel =
      cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(kernel_px, kernel_px));
  cv::Mat part;
  cv::dilate(mask(box), part, kernel);
  part.copyTo(result(box));
  return result;
}

cv::Mat fillBetween(const cv::Mat& mask) {
  cv::Mat result = cv::Mat::zeros(mask.rows, mask.cols, CV_8UC1);
  const std::vector<cv::Point> extremes = findRowExtremes(mask);
  if (extremes.empty()) return result;
  std::vector<cv::Point> hull;
  cv::convexHull(extremes, hull);
  cv::fillConvexPoly(result, hull, cv::Scalar(255));
  return result;
}

cv::Mat applyOperator(const Predicate& predicate, const cv::Mat& labels,
                      const std::vector<LabelClass>& classes, int kernel_px) {
  const cv::Mat mask = selectClass(labels, classes, predicate.class_name);
  switch (predicate.spatial_operator) {
    case SpatialOperator::kAround:
      return dilateAround(mask, kernel_px);
    case SpatialOperator::kBetween:
      return fillBetween(mask);
    default:
      return mask;
  }
}

ImageSets computeImageSets(const cv::Mat& labels, const std::vector<LabelClass>& classes,
                           const std::vector<Predicate>& predicates, int kernel_px) {
  ImageSets sets;
  sets.safe = cv::Mat::zeros(labels.rows, labels.cols, CV_8UC1);
  sets.rule = cv::Mat::zeros(labels.rows, labels.cols, CV_8UC1);
  cv::Mat unsafe = cv::Mat::zeros(labels.rows, labels.cols, CV_8UC1);
  for (size_t i = 0; i < predicates.size(); ++i) {
    const cv::Mat region = applyOperator(predicates[i], labels, classes, kernel_px);
    if (!predicates[i].isUnsafe()) {
      cv::bitwise_or(sets.safe, region, sets.safe);
      continue;
    }
    cv::bitwise_or(unsafe, region, unsafe);
    if (i < 254) sets.rule.setTo(cv::Scalar(static_cast<double>(i + 1)), region);
  }
  sets.safe.setTo(cv::Scalar(0), unsafe);
  return sets;
}

}  // namespace core_perception
