// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/predicates.h"

namespace core_perception {

/// ON(class), NEAR(class): 255 where the label belongs to the class, else 0. Source: [CORE]
/// appendix, spatial operators.
/// @param labels CV_16UC1. @returns CV_8UC1 of the same size.
cv::Mat selectClass(const cv::Mat& labels, const std::vector<LabelClass>& classes,
                    const std::string& class_name);

/// AROUND(class): the mask dilated by an elliptic kernel of kernel_px x kernel_px, anchored at its
/// centre; bit-equal to
///     cv::dilate(mask, out, cv::getStructuringElement(cv::MORPH_ELLIPSE, {kernel_px, kernel_px}))
/// @param mask CV_8UC1, 0 or 255.
cv::Mat dilateAround(const cv::Mat& mask, int kernel_px);

/// BETWEEN(class): the filled convex hull of all pixels of the mask; bit-equal to findNonZero,
/// convexHull, fillConvexPoly. An empty mask stays empty.
cv::Mat fillBetween(const cv::Mat& mask);

/// The operator applied to the class of the predicate; verdict and severity do not matter here.
cv::Mat applyOperator(const Predicate& predicate, const cv::Mat& labels,
                      const std::vector<LabelClass>& classes, int kernel_px);

/// Partition of the image, and which unsafe predicate holds where.
struct ImageSets {
  cv::Mat safe;  ///< CV_8UC1: 255 in (union of safe sets) minus (union of unsafe sets), else 0
  cv::Mat rule;  ///< CV_8UC1: 1 + index into the predicates of the last unsafe one that holds, 0
                 ///< for none (or index > 253)
};

/// I_safe = (union_j I_j_safe) \ (union_k I_k_unsafe). Source: [CORE] semantic grounding.
/// Severity is not part of [CORE]: here SLOW is taken as STOP.
ImageSets computeImageSets(const cv::Mat& labels, const std::vector<LabelClass>& classes,
                           const std::vector<Predicate>& predicates, int kernel_px);

}  // namespace core_perception
