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

/// A set of pixels as bits, for the union of many runs.
class BitImage {
 public:
  BitImage(int width, int height)
      : width_(width),
        height_(height),
        words_(width / kBits + 1),
        bits_(static_cast<size_t>(words_) * height, 0) {}

  /// Adds a run, which must not be empty, to a row.
  void add(const Run& run, int row) {
    uint64_t* words = &bits_[static_cast<size_t>(row) * words_];
    const int first = run.first / kBits, last = (run.end - 1) / kBits;
    const uint64_t from = ~uint64_t{0} << run.first % kBits;
    const uint64_t to = ~uint64_t{0} >> (kBits - 1 - (run.end - 1) % kBits);
    words[first] |= first == last ? from & to : from;
    for (int i = first + 1; i < last; ++i) words[i] = ~uint64_t{0};
    if (first < last) words[last] |= to;
  }

  PixelSet findRuns() const {
    PixelSet set(width_, height_);
    for (int v = 0; v < height_; ++v) {
      // Where a bit differs from the one before it a run begins or ends; the last bit is never set.
      uint64_t before = 0;
      int first = -1;
      for (int i = 0; i < words_; ++i) {
        const uint64_t word = bits_[static_cast<size_t>(v) * words_ + i];
        uint64_t edges = word ^ (word << 1 | before);
        before = word >> (kBits - 1);
        for (; edges != 0; edges &= edges - 1) {
          const int u = i * kBits + __builtin_ctzll(edges);
          if (first >= 0) set.append({first, u});
          first = first >= 0 ? -1 : u;
        }
      }
      set.closeRow();
    }
    return set;
  }

 private:
  static constexpr int kBits = 64;
  int width_, height_;
  int words_;  ///< of a row
  std::vector<uint64_t> bits_;
};

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
  BitImage result(set.width(), set.height());
  for (int v = 0; v < set.height(); ++v) {
    if (set.begin(v) == set.end(v)) continue;
    for (const KernelRow& row : kernel) {
      const int to = v + row.down;
      if (to < 0 || to >= set.height()) continue;
      const PixelSet& source = row.closesGaps() ? closed : set;
      for (const Run* run = source.begin(v); run != source.end(v); ++run) {
        const Run grown{std::max(run->first + row.left, 0),
                        std::min(run->end + row.right, set.width())};
        if (grown.first < grown.end) result.add(grown, to);
      }
    }
  }
  return result.findRuns();
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

void ImageRegions::compute(const LabelRuns& labels, const std::vector<LabelClass>& classes,
                           const std::vector<Predicate>& predicates) {
  findClasses(labels, classes, predicates);
  image_.create(labels.height(), labels.width(), CV_8UC1);
  image_.setTo(cv::Scalar(kNoRegion));
  for (const Predicate& predicate : predicates) {
    if (!predicate.isUnsafe()) paint(predicate, kSafeRegion);
  }
  for (size_t i = 0; i < predicates.size(); ++i) {
    if (predicates[i].isUnsafe())
      paint(predicates[i], static_cast<uint8_t>(std::min<size_t>(i + 1, kOtherUnsafe)));
  }
}

void ImageRegions::findClasses(const LabelRuns& labels, const std::vector<LabelClass>& classes,
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
  for (PixelSet& set : sets_) set.reset(labels.width(), labels.height());
  for (int v = 0; v < labels.height(); ++v) {
    for (const LabelRuns::LabelRun* run = labels.begin(v); run != labels.end(v); ++run) {
      const uint16_t number = class_of_[run->label];
      if (number > 0) sets_[number - 1].append(*run);
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
