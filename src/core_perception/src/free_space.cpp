// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/free_space.h"

#include <cmath>
#include <limits>

namespace core_perception {
namespace {

/// Square range of columns, both ends included.
struct ColumnRange {
  int min_x, min_y, max_x, max_y;
};

ColumnRange findReach(const Projection& projection, double resolution_m) {
  const auto toIndex = [resolution_m](double coordinate_m) {
    return static_cast<int>(std::floor(coordinate_m / resolution_m));
  };
  const Eigen::Vector3d& p = projection.p_map_camera();
  const double reach_m = projection.reach_m();
  return {toIndex(p.x() - reach_m), toIndex(p.y() - reach_m), toIndex(p.x() + reach_m),
          toIndex(p.y() + reach_m)};
}

constexpr int kNoFloor = std::numeric_limits<int>::min();

/// Layer of the floor that the frame saw in a column; kNoFloor where it saw none, or something that
/// stands up.
int findBareFloor(const FrameVotes& votes, const VoteMap& map, int x, int y) {
  int layer = kNoFloor;
  for (int z = map.bandMin(); z <= map.bandMax(); ++z) {
    const VoxelTally* tally = votes.find({x, y, z});
    if (tally == nullptr) continue;
    if (tally->n_metric() > 0) return kNoFloor;
    if (tally->n_safe() + tally->n_unsafe() > 0 && layer == kNoFloor) layer = z;
  }
  return layer;
}

int findLowestUnsafe(const VoteMap& map, int x, int y) {
  int z = map.bandMin();
  while (z < map.bandMax() && map.counts({x, y, z}).n_unsafe == 0) ++z;
  return z;
}

/// Whether the image holds all of the floor of a column: then it shows the foot of what stands
/// there.
bool isFloorInView(const Projection& projection, const VoxelIndex& column, double resolution_m,
                   double floor_m) {
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector3d corner((column.x + i % 2) * resolution_m,
                                 (column.y + i / 2) * resolution_m, floor_m);
    if (!projection.isInImage(projection.project(corner))) return false;
  }
  return true;
}

}  // namespace

bool isSeenThrough(const cv::Mat& metres, const Projection& projection,
                   const Eigen::Vector3d& centre, double resolution_m, bool no_depth_is_beyond,
                   bool outside_is_beyond) {
  const double radius_m = 0.5 * std::sqrt(3.0) * resolution_m;
  const Eigen::Vector3d pixel = projection.project(centre);
  if (pixel.z() <= 2.0 * radius_m) return false;
  const double half_u = projection.camera().fx_px * radius_m / (pixel.z() - radius_m);
  const double half_v = projection.camera().fy_px * radius_m / (pixel.z() - radius_m);
  const bool inside = pixel.x() - half_u >= 0.0 && pixel.y() - half_v >= 0.0 &&
                      pixel.x() + half_u <= metres.cols - 1 &&
                      pixel.y() + half_v <= metres.rows - 1;
  if (!inside && !outside_is_beyond) return false;
  const auto beyond_m = static_cast<float>(pixel.z() + radius_m);
  for (int i = -2; i <= 2; ++i) {
    const long v = std::lround(pixel.y() + 0.5 * i * half_v);
    if (v < 0 || v >= metres.rows) continue;
    const float* row = metres.ptr<float>(static_cast<int>(v));
    for (int j = -2; j <= 2; ++j) {
      const long u = std::lround(pixel.x() + 0.5 * j * half_u);
      if (u < 0 || u >= metres.cols) continue;
      const float depth_m = row[u];
      if (depth_m > 0.0f ? depth_m <= beyond_m : !no_depth_is_beyond) return false;
    }
  }
  return true;
}

int clearSeenThrough(const cv::Mat& metres, const Projection& projection, const FrameVotes& votes,
                     const LocalFloor& floor, VoteMap* map) {
  const double resolution_m = map->tree().getResolution();
  const ColumnRange range = findReach(projection, resolution_m);
  int n_cleared = 0;
  for (int y = range.min_y; y <= range.max_y; ++y) {
    for (int x = range.min_x; x <= range.max_x; ++x) {
      const Column* column = map->find(x, y);
      if (column == nullptr || column->counts.n_unsafe == 0) continue;
      const int floor_layer = findBareFloor(votes, *map, x, y);
      const bool only_floor = floor_layer != kNoFloor;
      const double floor_m = floor.height_m((x + 0.5) * resolution_m, (y + 0.5) * resolution_m);
      // What hangs over the floor shows no foot.
      const bool stands = only_floor && findLowestUnsafe(*map, x, y) <= floor_layer + 1;
      const bool shows_foot = stands && isFloorInView(projection, {x, y, floor_layer}, resolution_m,
                                                      floor_layer * resolution_m + floor_m);
      for (int z = map->bandMin(); z <= map->bandMax(); ++z) {
        const VoxelIndex voxel{x, y, z};
        if (map->counts(voxel).n_unsafe == 0 || votes.find(voxel) != nullptr) continue;
        Eigen::Vector3d centre = Eigen::Vector3d(x + 0.5, y + 0.5, z + 0.5) * resolution_m;
        centre.z() += floor_m;
        const bool may_be_cut = shows_foot && map->isMobile(voxel);
        if (!isSeenThrough(metres, projection, centre, resolution_m, only_floor, may_be_cut))
          continue;
        map->contradictVoxel(voxel);
        ++n_cleared;
      }
    }
  }
  return n_cleared;
}

}  // namespace core_perception
