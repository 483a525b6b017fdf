// SPDX-License-Identifier: BSD-3-Clause
#include "octomap_insertion.h"

namespace core_perception {
namespace bench {

octomap::Pointcloud makeCloud(const Frame& frame, const RangeParams& range) {
  octomap::Pointcloud cloud;
  const Camera& camera = frame.camera;
  for (int v = 0; v < frame.depth.rows; ++v) {
    for (int u = 0; u < frame.depth.cols; ++u) {
      const double z = frame.depth.at<uint16_t>(v, u) / 1000.0;
      if (z < range.range_min_m || z > range.range_max_m) continue;
      const Eigen::Vector3d p =
          frame.T_map_camera * Eigen::Vector3d((u - camera.cx_px) / camera.fx_px * z,
                                               (v - camera.cy_px) / camera.fy_px * z, z);
      cloud.push_back(static_cast<float>(p.x()), static_cast<float>(p.y()),
                      static_cast<float>(p.z()));
    }
  }
  return cloud;
}

void insertCloud(const octomap::Pointcloud& cloud, const Frame& frame, bool discretize,
                 octomap::OcTree* tree) {
  const Eigen::Vector3f eye = frame.T_map_camera.translation().cast<float>();
  const octomap::point3d origin(eye.x(), eye.y(), eye.z());
  constexpr double kNoLimit = -1.0;
  constexpr bool kLazy = false;
  tree->insertPointCloud(cloud, origin, kNoLimit, kLazy, discretize);
}

}  // namespace bench
}  // namespace core_perception
