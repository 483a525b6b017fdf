// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/instance_detector.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace core_perception {
namespace {

constexpr int kCoarse = 2;  // bins along the edge of a cell of the connectivity grid (0.1 m)

}  // namespace

constexpr double InstanceDetector::kBin_m;

InstanceDetector::InstanceDetector(double map_resolution_m, int min_points)
    : map_resolution_m_(map_resolution_m), min_points_(static_cast<uint32_t>(min_points)) {}

void InstanceDetector::start(const Eigen::Vector3d& p_map_camera, double reach_m) {
  for (const Bin& bin : bins_) heads_[cellOf(bin.x, bin.y)] = -1;
  bins_.clear();
  p_map_camera_ = p_map_camera;
  const int reach = static_cast<int>(std::ceil(reach_m / kBin_m)) + 1;
  if (width_ != 2 * reach + 1) {
    width_ = 2 * reach + 1;
    heads_.assign(static_cast<size_t>(width_) * width_, -1);
  }
  // Bins are those of the fixed frame, wherever the camera is: a thing at rest keeps its bins.
  const auto offset = [reach](double p_m) {
    return static_cast<float>(p_m / kBin_m - std::floor(p_m / kBin_m) + reach);
  };
  offset_x_ = offset(p_map_camera.x());
  offset_y_ = offset(p_map_camera.y());
}

const InstanceDetector::Bin* InstanceDetector::find(int16_t slot, int x, int y) const {
  if (x < 0 || y < 0 || x >= width_ || y >= width_) return nullptr;
  int32_t i = heads_[cellOf(x, y)];
  while (i >= 0 && bins_[i].slot != slot) i = bins_[i].next;
  return i >= 0 ? &bins_[i] : nullptr;
}

InstanceDetector::Bin& InstanceDetector::addBin(int16_t slot, int x, int y) {
  int32_t& head = heads_[cellOf(x, y)];
  Bin bin;
  bin.slot = slot;
  bin.x = x;
  bin.y = y;
  bin.next = head;
  head = static_cast<int32_t>(bins_.size());
  bins_.push_back(bin);
  return bins_.back();
}

std::vector<Detection> InstanceDetector::finish(const std::vector<std::string>& class_names) const {
  std::vector<Bins> slots(class_names.size());
  for (const Bin& bin : bins_) slots.at(bin.slot).push_back(&bin);
  std::vector<Detection> detections;
  for (size_t i = 0; i < slots.size(); ++i) {
    if (!slots[i].empty()) splitSlot(slots[i], class_names[i], &detections);
  }
  return detections;
}

void InstanceDetector::splitSlot(const Bins& bins, const std::string& class_name,
                                 std::vector<Detection>* detections) const {
  std::vector<cv::Point> cells;
  for (const Bin* bin : bins) cells.emplace_back(bin->x / kCoarse, bin->y / kCoarse);
  cv::Rect box = cv::boundingRect(cells);
  box -= cv::Point(1, 1);
  box += cv::Size(2, 2);
  cv::Mat grid = cv::Mat::zeros(box.height, box.width, CV_8UC1);
  for (const cv::Point& cell : cells) grid.at<uint8_t>(cell - box.tl()) = 255;
  // A margin of one cell around each joins what is up to two cells apart.
  cv::dilate(grid, grid, cv::Mat::ones(3, 3, CV_8UC1));
  cv::Mat groups;
  const int n_groups = cv::connectedComponents(grid, groups, 8, CV_32S);
  std::vector<Bins> members(n_groups);
  for (size_t i = 0; i < bins.size(); ++i)
    members[groups.at<int>(cells[i] - box.tl())].push_back(bins[i]);
  for (const Bins& group : members) {
    if (!group.empty()) appendDetection(keepStanding(group), class_name, detections);
  }
}

InstanceDetector::Bins InstanceDetector::keepStanding(const Bins& bins) const {
  uint32_t n_standing = 0;
  for (const Bin* bin : bins) n_standing += bin->n_standing;
  if (n_standing < min_points_) return bins;  // a flat thing
  // Neighbours of a slot are always of one group.
  const auto is_beside_standing = [this](const Bin& bin) {
    for (int k = 0; k < 9; ++k) {
      const Bin* other = find(bin.slot, bin.x + k % 3 - 1, bin.y + k / 3 - 1);
      if (other != nullptr && other->n_standing > 0) return true;
    }
    return false;
  };
  Bins kept;
  for (const Bin* bin : bins) {
    if (bin->n_standing > 0 || is_beside_standing(*bin)) kept.push_back(bin);
  }
  return kept;
}

/// Means of the bins that can be a corner of the hull: one that has bins to its left and to its
/// right both in a row above and in a row below lies within the mean points of those four.
std::vector<Point2> InstanceDetector::findRim(const std::vector<Point2>& means, const Bins& bins) {
  const auto lower = [](const Bin* a, const Bin* b) { return a->y < b->y; };
  const auto ends = std::minmax_element(bins.begin(), bins.end(), lower);
  const int first_y = (*ends.first)->y, n_rows = (*ends.second)->y - first_y + 1;
  struct Span {
    int min_x = std::numeric_limits<int>::max(), max_x = std::numeric_limits<int>::min();
    void add(const Span& other) {
      min_x = std::min(min_x, other.min_x);
      max_x = std::max(max_x, other.max_x);
    }
  };
  // Spans of all rows before and after a row.
  std::vector<Span> rows(n_rows), before(n_rows + 1), after(n_rows + 1);
  for (const Bin* bin : bins) rows[bin->y - first_y].add({bin->x, bin->x});
  for (int i = 0; i < n_rows; ++i) {
    before[i + 1] = before[i];
    before[i + 1].add(rows[i]);
  }
  for (int i = n_rows - 1; i > 0; --i) {
    after[i - 1] = after[i];
    after[i - 1].add(rows[i]);
  }
  std::vector<Point2> rim;
  for (size_t i = 0; i < bins.size(); ++i) {
    const int x = bins[i]->x, row = bins[i]->y - first_y;
    const bool inside = before[row].min_x < x && x < before[row].max_x && after[row].min_x < x &&
                        x < after[row].max_x;
    if (!inside) rim.push_back(means[i]);
  }
  return rim;
}

void InstanceDetector::appendDetection(const Bins& bins, const std::string& class_name,
                                       std::vector<Detection>* detections) const {
  Detection detection;
  for (const Bin* bin : bins) detection.n_points += bin->n_points;
  if (detection.n_points < min_points_) return;
  detection.class_name = class_name;
  std::vector<Point2> means;
  auto z_min_m = std::numeric_limits<float>::infinity(), z_max_m = -z_min_m;
  for (const Bin* bin : bins) {
    const Point2 mean{p_map_camera_.x() + bin->sum_x_m / bin->n_points,
                      p_map_camera_.y() + bin->sum_y_m / bin->n_points};
    means.push_back(mean);
    const CellIndex cell{static_cast<int>(std::floor(mean.x / map_resolution_m_)),
                         static_cast<int>(std::floor(mean.y / map_resolution_m_))};
    if (detection.cells.empty() || !(detection.cells.back() == cell))
      detection.cells.push_back(cell);
    z_min_m = std::min(z_min_m, bin->z_min_m);
    z_max_m = std::max(z_max_m, bin->z_max_m);
  }
  detection.z_min_m = p_map_camera_.z() + z_min_m;
  detection.z_max_m = p_map_camera_.z() + z_max_m;
  detection.footprint = computeConvexHull(findRim(means, bins));
  std::sort(detection.cells.begin(), detection.cells.end());
  detection.cells.erase(std::unique(detection.cells.begin(), detection.cells.end()),
                        detection.cells.end());
  detections->push_back(std::move(detection));
}

}  // namespace core_perception
