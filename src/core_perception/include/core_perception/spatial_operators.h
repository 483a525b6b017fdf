// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/pixel_set.h"
#include "core_perception/predicates.h"

namespace core_perception {

/// AROUND(class): the set dilated by an elliptic kernel of kernel_px x kernel_px, anchored at its
/// centre; bit-equal to
///     cv::dilate(mask, out, cv::getStructuringElement(cv::MORPH_ELLIPSE, {kernel_px, kernel_px}))
/// Source: [CORE] appendix, spatial operators. Differs: every row of the kernel is one run, and so
/// is what it makes of a run; those are joined as bits.
PixelSet dilateAround(const PixelSet& set, int kernel_px);

/// BETWEEN(class): the filled convex hull of all pixels of the set; bit-equal to findNonZero,
/// convexHull, fillConvexPoly. An empty set stays empty.
PixelSet fillBetween(const PixelSet& set);

/// What the pixels of an image are by the operators, see ImageRegions.
constexpr uint8_t kNoRegion = 0;       ///< no predicate holds
constexpr uint8_t kMostRules = 253;    ///< 1 ... 253: unsafe, 1 + index of the last such predicate
constexpr uint8_t kOtherUnsafe = 254;  ///< unsafe by a predicate of a larger index
constexpr uint8_t kSafeRegion = 255;

/// Partition of an image by the spatial operators over the classes of its labels:
///
///     I_safe = (union_j I_j_safe) \ (union_k I_k_unsafe)
///
/// ON and NEAR of a class are its pixels, AROUND and BETWEEN as above. Source: [CORE] semantic
/// grounding. Severity is not part of [CORE]: here SLOW is taken as STOP.
class ImageRegions {
 public:
  explicit ImageRegions(int kernel_px) : kernel_px_(kernel_px) {}

  void compute(const LabelRuns& labels, const std::vector<LabelClass>& classes,
               const std::vector<Predicate>& predicates);
  /// CV_8UC1 of the size of the labels.
  const cv::Mat& image() const { return image_; }

 private:
  void findClasses(const LabelRuns& labels, const std::vector<LabelClass>& classes,
                   const std::vector<Predicate>& predicates);
  void paint(const Predicate& predicate, uint8_t value);

  int kernel_px_;
  std::vector<std::string> names_;  ///< classes the predicates speak of
  std::vector<PixelSet> sets_;      ///< their pixels
  std::vector<uint16_t> class_of_;  ///< by label: 1 + index into names_, 0 for none
  cv::Mat image_;
};

}  // namespace core_perception
