// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/predicates.h"

namespace core_perception {
namespace bench {

/// I_safe = (union of safe sets) minus (union of unsafe sets), 255 or 0, as one writes it down from
/// the appendix of [CORE] with OpenCV: inRange, dilate with an elliptic kernel, findNonZero +
/// convexHull + fillConvexPoly. Shares no code with the library.
cv::Mat drawSafeMask(const Frame& frame, const std::vector<Predicate>& predicates, int kernel_px);

}  // namespace bench
}  // namespace core_perception
