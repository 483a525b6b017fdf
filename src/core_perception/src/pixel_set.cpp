// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/pixel_set.h"

#include <algorithm>
#include <cstring>

namespace core_perception {

namespace {

/// End of the run of equal values that begins at values[first]; at most end.
int findRunEnd(const uint16_t* values, int first, int end) {
  const uint16_t value = values[first];
  // Four at a time.
  const uint64_t pattern = value * uint64_t{0x0001000100010001};
  int u = first + 1;
  for (uint64_t four; u + 4 <= end; u += 4) {
    std::memcpy(&four, values + u, sizeof(four));
    if (four != pattern) break;
  }
  while (u < end && values[u] == value) ++u;
  return u;
}

}  // namespace

void LabelRuns::build(const cv::Mat& labels) {
  width_ = labels.cols;
  runs_.clear();
  ends_.clear();
  for (int v = 0; v < labels.rows; ++v) {
    const uint16_t* row = labels.ptr<uint16_t>(v);
    for (int u = 0; u < labels.cols;) {
      LabelRun run;
      run.first = u;
      run.label = row[u];
      run.end = u = findRunEnd(row, u, labels.cols);
      runs_.push_back(run);
    }
    ends_.push_back(static_cast<uint32_t>(runs_.size()));
  }
}

void PixelSet::reset(int width, int height) {
  width_ = width;
  height_ = height;
  runs_.clear();
  ends_.clear();
}

void PixelSet::paint(uint8_t value, cv::Mat* image) const {
  for (int v = 0; v < height_; ++v) {
    uint8_t* row = image->ptr<uint8_t>(v);
    for (const Run* run = begin(v); run != end(v); ++run)
      std::memset(row + run->first, value, static_cast<size_t>(run->end - run->first));
  }
}

PixelSet findPixels(const cv::Mat& mask) {
  PixelSet set(mask.cols, mask.rows);
  for (int v = 0; v < mask.rows; ++v) {
    const uint8_t* row = mask.ptr<uint8_t>(v);
    for (int u = 0; u < mask.cols;) {
      const uint8_t* first = std::find_if(row + u, row + mask.cols, [](uint8_t p) { return p; });
      const uint8_t* end = std::find(first, row + mask.cols, uint8_t{0});
      if (first != end) set.append({static_cast<int>(first - row), static_cast<int>(end - row)});
      u = static_cast<int>(end - row);
    }
    set.closeRow();
  }
  return set;
}

}  // namespace core_perception
