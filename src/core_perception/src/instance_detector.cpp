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

InstanceDetector::Bin& InstanceDetector::touchBin(int16_t slot, int x, int y) {
  int32_t& head = heads_[cellOf(x, y)];
  for (int32_t i = head; i >= 0; i = bins_[i].next) {
    if (bins_[i].slot == slot) return bins_[i];
  }
  Bin bin;
  bin.slot = slot;
  bin.x = x;
  bin.y = y;
  bin.next = head;
  head = static_cast<int32_t>(bins_.size());
  bins_.push_back(bin);
  return bins_.back();
}

void InstanceDetector::add(int16_t slot, const Eigen::Vector3f& d_m, bool standing) {
  constexpr auto kBinsPerMetre = static_cast<float>(1.0 / kBin_m);
  // Within reach neither is negative, so that the conversion is floor().
  const int x = static_cast<int>(offset_x_ + d_m.x() * kBinsPerMetre);
  const int y = static_cast<int>(offset_y_ + d_m.y() * kBinsPerMetre);
  if (x < 0 || y < 0 || x >= width_ || y >= width_) return;  // a pose that stretches a little
  Bin& bin = touchBin(slot, x, y);
  bin.z_min_m = std::min(bin.z_min_m, d_m.z());
  bin.z_max_m = std::max(bin.z_max_m, d_m.z());
  bin.sum_x_m += d_m.x();
  bin.sum_y_m += d_m.y();
  ++bin.n_points;
  if (standing) ++bin.n_standing;
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

void InstanceDetector::appendDetection(const Bins& bins, const std::string& class_name,
                                       std::vector<Detection>* detections) const {
  Detection detection;
  detection.class_name = class_name;
  std::vector<Point2> points;
  auto z_min_m = std::numeric_limits<float>::infinity(), z_max_m = -z_min_m;
  for (const Bin* bin : bins) {
    const Point2 mean{p_map_camera_.x() + bin->sum_x_m / bin->n_points,
                      p_map_camera_.y() + bin->sum_y_m / bin->n_points};
    points.push_back(mean);
    detection.cells.push_back({static_cast<int>(std::floor(mean.x / map_resolution_m_)),
                               static_cast<int>(std::floor(mean.y / map_resolution_m_))});
    z_min_m = std::min(z_min_m, bin->z_min_m);
    z_max_m = std::max(z_max_m, bin->z_max_m);
    detection.n_points += bin->n_points;
  }
  if (detection.n_points < min_points_) return;
  detection.z_min_m = p_map_camera_.z() + z_min_m;
  detection.z_max_m = p_map_camera_.z() + z_max_m;
  detection.footprint = computeConvexHull(std::move(points));
  std::sort(detection.cells.begin(), detection.cells.end());
  detection.cells.erase(std::unique(detection.cells.begin(), detection.cells.end()),
                        detection.cells.end());
  detections->push_back(std::move(detection));
}

}  // namespace core_perception
