// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>

#include "core_perception/ros/conversions.h"

namespace core_perception {
namespace {

nav_msgs::OccupancyGrid makeOccupancyGrid(const GridFrame& frame, const std_msgs::Header& header) {
  nav_msgs::OccupancyGrid message;
  message.header = header;
  message.info.map_load_time = header.stamp;
  message.info.resolution = static_cast<float>(frame.resolution_m);
  message.info.width = static_cast<uint32_t>(frame.width);
  message.info.height = static_cast<uint32_t>(frame.height);
  message.info.origin.position.x = frame.origin.x * frame.resolution_m;
  message.info.origin.position.y = frame.origin.y * frame.resolution_m;
  message.info.origin.orientation.w = 1.0;
  message.data.resize(static_cast<size_t>(frame.width) * frame.height, -1);
  return message;
}

core_msgs::UnsafeCause causeToMessage(const Cause& cause) {
  core_msgs::UnsafeCause message;
  message.rule = cause.rule;
  message.class_name = cause.class_name;
  message.instance_id = cause.instance_id;
  message.motion = cause.mobile ? core_msgs::UnsafeCause::MOBILE : core_msgs::UnsafeCause::STATIC;
  return message;
}

core_msgs::Instance instanceToMessage(const HeldInstance& held, bool is_unsafe) {
  core_msgs::Instance message;
  message.id = held.id;
  message.class_name = held.class_name;
  for (const Point2& corner : held.footprint) {
    geometry_msgs::Point32 point;
    point.x = static_cast<float>(corner.x);
    point.y = static_cast<float>(corner.y);
    message.footprint.push_back(point);
  }
  message.z_min_m = static_cast<float>(held.z_min_m);
  message.z_max_m = static_cast<float>(held.z_max_m);
  message.cluster = held.cluster;
  message.in_view = held.in_view;
  message.last_seen.fromSec(held.last_seen_s);
  message.frames_seen = held.frames_seen;
  message.verdict = is_unsafe ? core_msgs::Instance::UNSAFE : core_msgs::Instance::SAFE;
  return message;
}

}  // namespace

core_msgs::SafetyGrid safetyGridToMessage(const SafetyGrid& grid, const std_msgs::Header& header,
                                          const ros::Time& constraints_stamp) {
  core_msgs::SafetyGrid message;
  message.header = header;
  message.constraints_stamp = constraints_stamp;
  message.resolution_m = grid.frame.resolution_m;
  message.width = static_cast<uint32_t>(grid.frame.width);
  message.height = static_cast<uint32_t>(grid.frame.height);
  message.origin_x_m = grid.frame.origin.x * grid.frame.resolution_m;
  message.origin_y_m = grid.frame.origin.y * grid.frame.resolution_m;
  message.n_safe = grid.n_safe;
  message.n_unsafe = grid.n_unsafe;
  message.h_m = grid.h_m;
  message.state.reserve(grid.state.size());
  for (const CellState state : grid.state) message.state.push_back(static_cast<uint8_t>(state));
  message.unknown_is_unsafe = grid.unknown_is_unsafe;
  message.cause = grid.cause;
  for (const Cause& cause : grid.causes) message.causes.push_back(causeToMessage(cause));
  message.speed_cap_mps = grid.speed_cap_mps;
  return message;
}

core_msgs::InstanceArray instancesToMessage(const std::vector<HeldInstance>& instances,
                                            const std::vector<Predicate>& predicates,
                                            const std_msgs::Header& header) {
  core_msgs::InstanceArray message;
  message.header = header;
  for (const HeldInstance& held : instances) {
    message.instances.push_back(
        instanceToMessage(held, isUnsafeInstance(held, predicates, instances)));
  }
  return message;
}

nav_msgs::OccupancyGrid probabilityToMessage(const SafetyGrid& grid,
                                             const std_msgs::Header& header) {
  nav_msgs::OccupancyGrid message = makeOccupancyGrid(grid.frame, header);
  for (size_t i = 0; i < grid.state.size(); ++i) {
    const double total = static_cast<double>(grid.n_safe[i]) + grid.n_unsafe[i];
    const bool region = grid.state[i] == CellState::kUnsafe && grid.cause[i] != kNoCause &&
                        grid.causes[grid.cause[i]].instance_id != 0;
    if (region) {
      message.data[i] = 100;
    } else if (total > 0.0) {
      message.data[i] = static_cast<int8_t>(std::lround(100.0 * grid.n_unsafe[i] / total));
    }
  }
  return message;
}

nav_msgs::OccupancyGrid decisionToMessage(const SafetyGrid& grid, const std_msgs::Header& header) {
  nav_msgs::OccupancyGrid message = makeOccupancyGrid(grid.frame, header);
  for (size_t i = 0; i < grid.state.size(); ++i) {
    if (grid.state[i] != CellState::kUnknown)
      message.data[i] = grid.state[i] == CellState::kUnsafe ? 100 : 0;
  }
  return message;
}

octomap_msgs::Octomap octomapToMessage(WireFormat format, const std_msgs::Header& header,
                                       const TreeSnapshot& snapshot) {
  octomap_msgs::Octomap message;
  message.header = header;
  message.binary = format == WireFormat::kBinary;
  message.id = idOf(format);
  message.resolution = snapshot.resolution_m;
  message.data = serialise(format, snapshot);
  return message;
}

sensor_msgs::PointCloud2 centersToMessage(const std_msgs::Header& header,
                                          const TreeSnapshot& snapshot) {
  std::vector<float> xyz;
  forEachLeaf(snapshot, [&](const SnapshotLeaf& leaf) {
    if (!leaf.isUnsafe()) return;
    for (unsigned axis = 0; axis < 3; ++axis) {
      const double index = leaf.lowest[axis] - SemanticOcTree::kKeyOffset + 0.5 * leaf.edge();
      xyz.push_back(static_cast<float>(index * snapshot.resolution_m));
    }
  });
  sensor_msgs::PointCloud2 message;
  message.header = header;
  message.height = 1;
  message.width = static_cast<uint32_t>(xyz.size() / 3);
  for (const char* name : {"x", "y", "z"}) {
    sensor_msgs::PointField field;
    field.name = name;
    field.offset = static_cast<uint32_t>(4 * message.fields.size());
    field.datatype = sensor_msgs::PointField::FLOAT32;
    field.count = 1;
    message.fields.push_back(field);
  }
  message.point_step = 12;
  message.row_step = message.point_step * message.width;
  const auto* bytes = reinterpret_cast<const uint8_t*>(xyz.data());
  message.data.assign(bytes, bytes + 4 * xyz.size());
  message.is_dense = true;
  return message;
}

nav_msgs::OccupancyGrid groundPlanToMessage(const GroundPlan& plan,
                                            const std_msgs::Header& header) {
  nav_msgs::OccupancyGrid message = makeOccupancyGrid(plan.frame, header);
  message.data = plan.cells;
  return message;
}

map_msgs::OccupancyGridUpdate makeUpdate(const nav_msgs::OccupancyGrid& before,
                                         const nav_msgs::OccupancyGrid& after) {
  const int width = static_cast<int>(after.info.width);
  int x_min = width, x_max = -1, y_min = static_cast<int>(after.info.height), y_max = -1;
  for (size_t i = 0; i < after.data.size(); ++i) {
    if (after.data[i] == before.data[i]) continue;
    const int x = static_cast<int>(i) % width, y = static_cast<int>(i) / width;
    x_min = std::min(x_min, x);
    x_max = std::max(x_max, x);
    y_min = std::min(y_min, y);
    y_max = std::max(y_max, y);
  }
  map_msgs::OccupancyGridUpdate update;
  update.header = after.header;
  if (x_max < 0) return update;
  update.x = x_min;
  update.y = y_min;
  update.width = static_cast<uint32_t>(x_max - x_min + 1);
  update.height = static_cast<uint32_t>(y_max - y_min + 1);
  for (int y = y_min; y <= y_max; ++y) {
    const auto row = after.data.begin() + static_cast<long>(y) * width;
    update.data.insert(update.data.end(), row + x_min, row + x_max + 1);
  }
  return update;
}

}  // namespace core_perception
