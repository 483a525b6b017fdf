// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/instance_detector.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/imgproc.hpp>
#include <set>
#include <utility>

namespace core_perception {
namespace {

constexpr size_t kFirstTableSize = 1 << 14;  // a power of two
constexpr int kCoarse = 2;  // bins along the edge of a cell of the connectivity grid (0.1 m)

int floorDivide(int value, int step) {
  return value >= 0 ? value / step : -((step - 1 - value) / step);
}

size_t computeHash(int16_t slot, int x, int y) {
  uint64_t h = static_cast<uint32_t>(x) * 0x9E3779B97F4A7C15ull;
  h ^= static_cast<uint32_t>(y) * 0xC2B2AE3D27D4EB4Full +
       static_cast<uint16_t>(slot) * 0x165667B19E3779F9ull;
  return static_cast<size_t>(h ^ (h >> 29));
}

}  // namespace

constexpr double InstanceDetector::kBin_m;

InstanceDetector::InstanceDetector(double map_resolution_m, int min_points)
    : map_resolution_m_(map_resolution_m), min_points_(static_cast<uint32_t>(min_points)) {
  start();
}

void InstanceDetector::start() {
  bins_.clear();
  table_.assign(std::max(kFirstTableSize, table_.size()), -1);
}

InstanceDetector::Bin& InstanceDetector::touchBin(int16_t slot, int x, int y) {
  if (2 * bins_.size() >= table_.size()) {
    table_.assign(2 * table_.size(), -1);
    const size_t mask = table_.size() - 1;
    for (size_t i = 0; i < bins_.size(); ++i) {
      size_t at = computeHash(bins_[i].slot, bins_[i].x, bins_[i].y) & mask;
      while (table_[at] >= 0) at = (at + 1) & mask;
      table_[at] = static_cast<int32_t>(i);
    }
  }
  const size_t mask = table_.size() - 1;
  for (size_t at = computeHash(slot, x, y) & mask;; at = (at + 1) & mask) {
    if (table_[at] < 0) {
      table_[at] = static_cast<int32_t>(bins_.size());
      Bin bin;
      bin.slot = slot;
      bin.x = x;
      bin.y = y;
      bins_.push_back(bin);
      return bins_.back();
    }
    Bin& bin = bins_[table_[at]];
    if (bin.slot == slot && bin.x == x && bin.y == y) return bin;
  }
}

void InstanceDetector::add(int16_t slot, const Eigen::Vector3d& p_map, bool standing) {
  const double z_m = p_map.z();
  Bin& bin = touchBin(slot, static_cast<int>(std::floor(p_map.x() / kBin_m)),
                      static_cast<int>(std::floor(p_map.y() / kBin_m)));
  bin.z_min_m = bin.n_points == 0 ? z_m : std::min(bin.z_min_m, z_m);
  bin.z_max_m = bin.n_points == 0 ? z_m : std::max(bin.z_max_m, z_m);
  bin.sum_x += p_map.x();
  bin.sum_y += p_map.y();
  ++bin.n_points;
  if (standing) ++bin.n_standing;
}

std::vector<Detection> InstanceDetector::finish(const std::vector<std::string>& class_names) const {
  std::map<int16_t, std::vector<const Bin*>> slots;
  for (const Bin& bin : bins_) slots[bin.slot].push_back(&bin);
  std::vector<Detection> detections;
  for (const auto& slot : slots) splitSlot(slot.second, class_names.at(slot.first), &detections);
  return detections;
}

void InstanceDetector::splitSlot(const std::vector<const Bin*>& bins, const std::string& class_name,
                                 std::vector<Detection>* detections) const {
  std::vector<cv::Point> cells;
  for (const Bin* bin : bins)
    cells.emplace_back(floorDivide(bin->x, kCoarse), floorDivide(bin->y, kCoarse));
  cv::Rect box = cv::boundingRect(cells);
  box -= cv::Point(1, 1);
  box += cv::Size(2, 2);
  cv::Mat grid = cv::Mat::zeros(box.height, box.width, CV_8UC1);
  for (const cv::Point& cell : cells) grid.at<uint8_t>(cell - box.tl()) = 255;
  // A margin of one cell around each joins what is up to two cells apart.
  cv::dilate(grid, grid, cv::Mat::ones(3, 3, CV_8UC1));
  cv::Mat groups;
  const int n_groups = cv::connectedComponents(grid, groups, 8, CV_32S);
  std::vector<std::vector<const Bin*>> members(n_groups);
  for (size_t i = 0; i < bins.size(); ++i)
    members[groups.at<int>(cells[i] - box.tl())].push_back(bins[i]);
  for (const std::vector<const Bin*>& group : members) {
    appendDetection(keepStanding(group, min_points_), class_name, detections);
  }
}

std::vector<const InstanceDetector::Bin*> InstanceDetector::keepStanding(
    const std::vector<const Bin*>& bins, uint32_t min_points) {
  std::set<std::pair<int, int>> beside_standing;
  uint32_t n_standing = 0;
  for (const Bin* bin : bins) {
    n_standing += bin->n_standing;
    for (int k = 0; bin->n_standing > 0 && k < 9; ++k)
      beside_standing.emplace(bin->x + k % 3 - 1, bin->y + k / 3 - 1);
  }
  if (n_standing < min_points) return bins;  // a flat thing
  std::vector<const Bin*> kept;
  for (const Bin* bin : bins) {
    if (beside_standing.count({bin->x, bin->y}) > 0) kept.push_back(bin);
  }
  return kept;
}

void InstanceDetector::appendDetection(const std::vector<const Bin*>& bins,
                                       const std::string& class_name,
                                       std::vector<Detection>* detections) const {
  Detection detection;
  detection.class_name = class_name;
  std::vector<Point2> points;
  for (const Bin* bin : bins) {
    const Point2 mean{bin->sum_x / bin->n_points, bin->sum_y / bin->n_points};
    points.push_back(mean);
    detection.cells.push_back({static_cast<int>(std::floor(mean.x / map_resolution_m_)),
                               static_cast<int>(std::floor(mean.y / map_resolution_m_))});
    detection.z_min_m =
        detection.n_points == 0 ? bin->z_min_m : std::min(detection.z_min_m, bin->z_min_m);
    detection.z_max_m =
        detection.n_points == 0 ? bin->z_max_m : std::max(detection.z_max_m, bin->z_max_m);
    detection.n_points += bin->n_points;
  }
  if (detection.n_points < min_points_) return;
  detection.footprint = computeConvexHull(std::move(points));
  std::sort(detection.cells.begin(), detection.cells.end());
  detection.cells.erase(std::unique(detection.cells.begin(), detection.cells.end()),
                        detection.cells.end());
  detections->push_back(std::move(detection));
}

}  // namespace core_perception
