// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/params.h"
#include "core_perception/predicates.h"

namespace core_perception {
namespace bench {

/// Grounding of [CORE] as a straightforward programmer writes it with OpenCV: masks, one pixel
/// after the other into 2-D counts of the whole site, two distance transforms of the window. No
/// octree, no memory of objects.
class PlainPipeline {
 public:
  explicit PlainPipeline(const SemanticMapParams& params);

  /// Signed distance [m] around the robot, CV_32FC1.
  const cv::Mat& update(const Frame& frame, const std::vector<Predicate>& predicates);

 private:
  void count(const Frame& frame, const cv::Mat& safe);
  void measure(const Point2& robot);

  SemanticMapParams params_;
  cv::Mat n_safe_, n_unsafe_;  ///< CV_32SC1, the site with the origin in its middle
  Point2 first_;
  bool started_ = false;
  cv::Mat h_m_;
};

}  // namespace bench
}  // namespace core_perception
