// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/params.h"

#include <sstream>

#include "core_perception/exceptions.h"

namespace core_perception {
namespace {

void requireBelow(const std::string& low_key, double low, const std::string& high_key,
                  double high) {
  if (low < high) return;
  std::ostringstream got, allowed;
  got << low;
  allowed << "less than " << high_key << " (" << high << ")";
  throw ParameterError(low_key, got.str(), allowed.str());
}

void readRange(ParamReader* reader, RangeParams* p) {
  reader->read("floor_z_m", &p->floor_z_m, {-1000.0, 1000.0});
  reader->read("range_min_m", &p->range_min_m, {0.01, 50.0});
  reader->read("range_max_m", &p->range_max_m, {0.1, 50.0});
  reader->read("tree_min_z_m", &p->tree_min_z_m, {-20.0, 20.0});
  reader->read("tree_max_z_m", &p->tree_max_z_m, {-20.0, 20.0});
  reader->read("band_min_z_m", &p->band_min_z_m, {-20.0, 20.0});
  reader->read("band_max_z_m", &p->band_max_z_m, {-20.0, 20.0});
  reader->read("metric_min_height_m", &p->metric_min_height_m, {0.01, 2.0});
  reader->read("local_floor", &p->local_floor);
  reader->read("metric_slope", &p->metric_slope, {0.0, 0.2});
  reader->read("depth_edge_ratio", &p->depth_edge_ratio, {0.0, 1.0});
  requireBelow("range_min_m", p->range_min_m, "range_max_m", p->range_max_m);
  requireBelow("band_min_z_m", p->band_min_z_m, "band_max_z_m", p->band_max_z_m);
  requireBelow("tree_min_z_m", p->tree_min_z_m - 1e-9, "band_min_z_m", p->band_min_z_m);
  requireBelow("band_max_z_m", p->band_max_z_m, "tree_max_z_m", p->tree_max_z_m + 1e-9);
  requireBelow("metric_min_height_m", p->metric_min_height_m, "band_max_z_m", p->band_max_z_m);
}

void readVote(ParamReader* reader, VoteParams* p) {
  reader->read("votes", &p->votes, {"frame", "pixel"});
  reader->read("column", &p->column, {"worst", "sum"});
  reader->read("count_cap", &p->count_cap, {0, 1000000});
  reader->read("tau", &p->tau, {0.01, 1.0});
  reader->read("metric_layer", &p->metric_layer);
  reader->read("metric_min_points", &p->metric_min_points, {1, 1000});
  reader->read("free_space_clearing", &p->free_space_clearing);
  reader->read("mobile_half_life_s", &p->mobile_half_life_s, {0.0, 86400.0});
  if (p->column == "sum" && p->free_space_clearing) {
    // What is taken from a voxel cannot be taken from a sum of pixels that never forgets.
    throw ParameterError("free_space_clearing", "true", "false with column sum");
  }
}

void readInstance(ParamReader* reader, InstanceParams* p) {
  reader->read("surface_classes", &p->surface_classes);
  reader->read("mobile_classes", &p->mobile_classes);
  reader->read("mobile_release_s", &p->mobile_release_s, {0.0, 86400.0});
  reader->read("max_instances", &p->max_instances, {1, 5000});
  reader->read("min_points", &p->min_points, {1, 100000});
  reader->read("min_frames", &p->min_frames, {1, 100});
  reader->read("release_frames", &p->release_frames, {1, 1000});
  reader->read("match_distance_m", &p->match_distance_m, {0.0, 10.0});
  reader->read("footprint_slack_m", &p->footprint_slack_m, {0.0, 10.0});
  reader->read("mobile_slack_m", &p->mobile_slack_m, {0.0, 10.0});
  reader->read("max_footprint_m", &p->max_footprint_m, {0.1, 50.0});
  reader->read("between_max_gap_m", &p->between_max_gap_m, {0.0, 50.0});
  reader->read("between_min_thickness_m", &p->between_min_thickness_m, {0.0, 10.0});
  reader->read("default_radius_m", &p->default_radius_m, {0.0, 10.0});
  reader->read("class_radius_m", &p->class_radius_m, {0.0, 10.0});
}

void readWindow(ParamReader* reader, const SemanticMapParams& map, WindowParams* p) {
  reader->read("keep_radius_m", &p->keep_radius_m, {0.0, 10000.0});
  reader->read("outside", &p->outside, {"drop", "disk"});
  if (p->keep_radius_m == 0.0) return;
  if (p->keep_radius_m < map.window_m)
    throw ParameterError("keep_radius_m", std::to_string(p->keep_radius_m),
                         "0, or window_m or more");
  if (!map.unknown_is_unsafe) {
    // A hazard that was forgotten would be open ground.
    throw ParameterError("unknown_is_unsafe", "false", "true with keep_radius_m > 0");
  }
}

void checkNode(const NodeParams& p) {
  if (p.rectify && p.ignore_distortion) {
    // Rectified images would be rectified once more.
    throw ParameterError("rectify", "true", "false with ignore_distortion true");
  }
  const std::string kOdom = "odom";
  const std::string& frame = p.map_frame;
  const bool is_odom = frame.size() >= kOdom.size() &&
                       frame.compare(frame.size() - kOdom.size(), kOdom.size(), kOdom) == 0;
  if (!p.map_file.empty() && is_odom) {
    throw ParameterError("map_file", p.map_file,
                         "empty with map_frame " + frame + ", whose origin is new at every start");
  }
}

}  // namespace

SemanticMapParams SemanticMapParams::fromReader(ParamReader* reader) {
  SemanticMapParams p;
  reader->read("resolution_m", &p.resolution_m, {0.02, 2.0});
  reader->read("window_m", &p.window_m, {1.0, 100.0});
  reader->read("semantics", &p.semantics);
  reader->read("operators", &p.operators, {"ground", "image"});
  reader->read("kernel_px", &p.kernel_px, {1, 500});
  reader->read("unknown_is_unsafe", &p.unknown_is_unsafe);
  reader->read("initial_disc_radius_m", &p.initial_disc_radius_m, {0.0, 20.0});
  reader->read("distance", &p.distance, {"border", "centre"});
  reader->read("slow_speed_mps", &p.slow_speed_mps, {0.0, 10.0});
  readRange(reader, &p.range);
  readVote(reader, &p.vote);
  readInstance(reader, &p.instance);
  readWindow(reader, p, &p.window);
  if (!p.semantics && !p.vote.metric_layer) {
    throw ParameterError("metric_layer", "false",
                         "true with semantics false");  // all would be safe
  }
  // A window of more cells than this cannot be sent at the rate of the camera.
  requireBelow("window_m", p.window_m, "1000 cells of resolution_m",
               1000.0 * p.resolution_m + 1e-9);
  requireBelow("range_max_m", p.range.range_max_m, "200 cells of resolution_m",
               200.0 * p.resolution_m + 1e-9);
  requireBelow("tree_max_z_m", p.range.tree_max_z_m, "tree_min_z_m + 200 cells of resolution_m",
               p.range.tree_min_z_m + 200.0 * p.resolution_m + 1e-9);
  return p;
}

SemanticMapParams SemanticMapParams::fromMap(const ParamMap& values) {
  ParamReader reader(values);
  const SemanticMapParams p = fromReader(&reader);
  reader.finish();
  return p;
}

NodeParams NodeParams::fromMap(const ParamMap& values) {
  ParamReader reader(values);
  NodeParams p;
  reader.read("lockstep", &p.lockstep);
  reader.read("map_frame", &p.map_frame);
  reader.read("base_frame", &p.base_frame);
  reader.read("slop_s", &p.slop_s, {0.0, 1.0});
  reader.read("queue_size", &p.queue_size, {1, 1000});
  reader.read("octomap_period_s", &p.octomap_period_s, {0.05, 3600.0});
  reader.read("ignore_distortion", &p.ignore_distortion);
  reader.read("rectify", &p.rectify);
  reader.read("grid_period_s", &p.grid_period_s, {0.0, 3600.0});
  reader.readText("map_dir", &p.map_dir);
  reader.readText("map_file", &p.map_file);
  checkNode(p);
  p.map = SemanticMapParams::fromReader(&reader);
  reader.finish();
  return p;
}

}  // namespace core_perception
