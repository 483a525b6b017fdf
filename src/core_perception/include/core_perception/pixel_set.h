// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

namespace core_perception {

/// Pixels first, first + 1, ..., end - 1 of a row.
struct Run {
  int first, end;
};

/// A set of pixels as runs, row by row and in ascending order; runs of a row may touch, they never
/// overlap. Objects have few runs: what walks over them does not depend on the size of the image.
class PixelSet {
 public:
  PixelSet() = default;
  PixelSet(int width, int height) { reset(width, height); }

  /// Empties it; it keeps its memory.
  void reset(int width, int height);
  /// Adds a run to the row that is open, which is row 0 after reset.
  void append(const Run& run) { runs_.push_back(run); }
  /// Closes the open row; the next one is open then. To be called once for every row.
  void closeRow() { ends_.push_back(static_cast<uint32_t>(runs_.size())); }

  int width() const { return width_; }
  int height() const { return height_; }
  bool empty() const { return runs_.empty(); }
  const Run* begin(int row) const { return runs_.data() + (row == 0 ? 0 : ends_[row - 1]); }
  const Run* end(int row) const { return runs_.data() + ends_[row]; }

  /// Writes value to the pixels of the set.
  /// @param image CV_8UC1 of the size of the set.
  void paint(uint8_t value, cv::Mat* image) const;

 private:
  int width_ = 0, height_ = 0;
  std::vector<Run> runs_;
  std::vector<uint32_t> ends_;  ///< of every row: index of the first run of the next one
};

/// An image of labels as runs of equal ones, row by row and in ascending order.
class LabelRuns {
 public:
  struct LabelRun : Run {
    uint16_t label;
  };

  /// @param labels CV_16UC1.
  void build(const cv::Mat& labels);
  int width() const { return width_; }
  int height() const { return static_cast<int>(ends_.size()); }
  const LabelRun* begin(int row) const { return runs_.data() + (row == 0 ? 0 : ends_[row - 1]); }
  const LabelRun* end(int row) const { return runs_.data() + ends_[row]; }

 private:
  int width_ = 0;
  std::vector<LabelRun> runs_;
  std::vector<uint32_t> ends_;  ///< of every row: index of the first run of the next one
};

/// The set pixels (not 0) of a CV_8UC1 image.
PixelSet findPixels(const cv::Mat& mask);

}  // namespace core_perception
