// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/spatial_operators.h"

#include <algorithm>
#include <opencv2/imgproc.hpp>

namespace core_perception {
namespace {

/// Gaps of a row up to this are closed before a wide row of the kernel is applied, which would
/// close them anyway: a mask full of holes costs no more than a whole one [px].
constexpr int kClosedGap_px = 8;

/// What a row of the kernel does: from a run [first, end) of input row v it makes the run
/// [first + left, end + right) of output row v + down.
struct KernelRow {
  int down, left, right;
  bool closesGaps() const { return right - left >= kClosedGap_px; }
};

std::vector<KernelRow> makeKernel(int kernel_px) {
  const cv::Mat kernel =
      cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(kernel_px, kernel_px));
  const PixelSet pixels = findPixels(kernel);
  const int anchor = kernel_px / 2;
  std::vector<KernelRow> rows;
  for (int v = 0; v < kernel_px; ++v) {
    // OpenCV reads input pixel (u + column - anchor), so the kernel acts mirrored on the runs.
    for (const Run* run = pixels.begin(v); run != pixels.end(v); ++run)
      rows.push_back({anchor - v, anchor - (run->end - 1), anchor - run->first});
  }
  return rows;
}

PixelSet closeGaps(const PixelSet& set) {
  PixelSet closed(set.width(), set.height());
  for (int v = 0; v < set.height(); ++v) {
    const Run* run = set.begin(v);
    while (run != set.end(v)) {
      Run joined = *run++;
      for (; run != set.end(v) && run->first - joined.end <= kClosedGap_px; ++run)
        joined.end = run->end;
      closed.append(joined);
    }
    closed.closeRow();
  }
  return closed;
}

/// Joins runs that overlap; n_open[u] is the number that begin at u minus the number that end
/// there. Leaves n_open all zero.
void appendJoined(const Run& bounds, std::vector<int>* n_open, PixelSet* set) {
  int depth = 0, first = 0;
  for (int u = bounds.first; u <= bounds.end; ++u) {
    const int before = depth;
    depth += (*n_open)[u];
    (*n_open)[u] = 0;
    if (before == 0 && depth > 0) first = u;
    if (before > 0 && depth == 0) set->append({first, u});
  }
}

/// First and last pixel of every row that has one; no other can be a corner of the hull.
std::vector<cv::Point> findRowEnds(const PixelSet& set) {
  std::vector<cv::Point> points;
  for (int v = 0; v < set.height(); ++v) {
    if (set.begin(v) == set.end(v)) continue;
    points.emplace_back(set.begin(v)->first, v);
    points.emplace_back((set.end(v) - 1)->end - 1, v);
  }
  return points;
}

}  // namespace

PixelSet dilateAround(const PixelSet& set, int kernel_px) {
  const std::vector<KernelRow> kernel = makeKernel(kernel_px);
  const PixelSet closed = closeGaps(set);
  PixelSet result(set.width(), set.height());
  std::vector<int> n_open(static_cast<size_t>(set.width()) + 1, 0);
  for (int v = 0; v < set.height(); ++v) {
    Run bounds{set.width(), 0};
    for (const KernelRow& row : kernel) {
      const int from = v - row.down;
      if (from < 0 || from >= set.height()) continue;
      const PixelSet& source = row.closesGaps() ? closed : set;
      for (const Run* run = source.begin(from); run != source.end(from); ++run) {
        const int first = std::max(run->first + row.left, 0);
        const int end = std::min(run->end + row.right, set.width());
        if (first >= end) continue;
        ++n_open[first];
        --n_open[end];
        bounds.first = std::min(bounds.first, first);
        bounds.end = std::max(bounds.end, end);
      }
    }
    appendJoined(bounds, &n_open, &result);
    result.closeRow();
  }
  return result;
}

PixelSet fillBetween(const PixelSet& set) {
  const std::vector<cv::Point> ends = findRowEnds(set);
  PixelSet result(set.width(), set.height());
  cv::Mat filled;
  cv::Rect box;
  if (!ends.empty()) {
    std::vector<cv::Point> hull;
    cv::convexHull(ends, hull);
    box = cv::boundingRect(hull);
    for (cv::Point& corner : hull) corner -= box.tl();
    filled = cv::Mat::zeros(box.size(), CV_8UC1);
    cv::fillConvexPoly(filled, hull, cv::Scalar(255));
  }
  const PixelSet inside = findPixels(filled);
  for (int v = 0; v < set.height(); ++v) {
    if (v >= box.y && v < box.y + box.height) {
      for (const Run* run = inside.begin(v - box.y); run != inside.end(v - box.y); ++run)
        result.append({run->first + box.x, run->end + box.x});
    }
    result.closeRow();
  }
  return result;
}

void ImageRegions::compute(const cv::Mat& labels, const std::vector<LabelClass>& classes,
                           const std::vector<Predicate>& predicates) {
  findClasses(labels, classes, predicates);
  image_.create(labels.rows, labels.cols, CV_8UC1);
  image_.setTo(cv::Scalar(kNoRegion));
  for (const Predicate& predicate : predicates) {
    if (!predicate.isUnsafe()) paint(predicate, kSafeRegion);
  }
  for (size_t i = 0; i < predicates.size(); ++i) {
    if (predicates[i].isUnsafe())
      paint(predicates[i], static_cast<uint8_t>(std::min<size_t>(i + 1, kOtherUnsafe)));
  }
}

void ImageRegions::findClasses(const cv::Mat& labels, const std::vector<LabelClass>& classes,
                               const std::vector<Predicate>& predicates) {
  names_.clear();
  for (const Predicate& predicate : predicates) names_.push_back(predicate.class_name);
  std::sort(names_.begin(), names_.end());
  names_.erase(std::unique(names_.begin(), names_.end()), names_.end());
  class_of_.assign(65536, 0);
  for (const LabelClass& label : classes) {
    const auto at = std::lower_bound(names_.begin(), names_.end(), label.class_name);
    const bool spoken_of = label.id != 0 && at != names_.end() && *at == label.class_name;
    if (spoken_of) class_of_[label.id] = static_cast<uint16_t>(at - names_.begin() + 1);
  }
  sets_.resize(names_.size());
  for (PixelSet& set : sets_) set.reset(labels.cols, labels.rows);
  for (int v = 0; v < labels.rows; ++v) {
    const uint16_t* row = labels.ptr<uint16_t>(v);
    for (int u = 0, end = 0; u < labels.cols; u = end) {
      for (end = u + 1; end < labels.cols && row[end] == row[u];) ++end;
      const uint16_t number = class_of_[row[u]];
      if (number > 0) sets_[number - 1].append({u, end});
    }
    for (PixelSet& set : sets_) set.closeRow();
  }
}

void ImageRegions::paint(const Predicate& predicate, uint8_t value) {
  const auto at = std::lower_bound(names_.begin(), names_.end(), predicate.class_name);
  const PixelSet& set = sets_[at - names_.begin()];
  switch (predicate.spatial_operator) {
    case SpatialOperator::kAround:
      return dilateAround(set, kernel_px_).paint(value, &image_);
    case SpatialOperator::kBetween:
      return fillBetween(set).paint(value, &image_);
    default:
      return set.paint(value, &image_);
  }
}

}  // namespace core_perception
