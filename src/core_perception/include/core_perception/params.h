// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <string>
#include <vector>

#include "core_perception/param_reader.h"

namespace core_perception {

/// Heights and ranges of the points that are used. Heights are above the floor.
struct RangeParams {
  double floor_z_m = 0.0;             ///< height of the floor in the fixed frame
  double range_min_m = 0.3;           ///< z-depth nearer than this is discarded
  double range_max_m = 7.0;           ///< z-depth farther than this is discarded
  double tree_min_z_m = -1.0;         ///< lower end of the 3-D map
  double tree_max_z_m = 3.0;          ///< upper end of the 3-D map
  double band_min_z_m = -0.15;        ///< lower end of what counts for a column of the 2-D map
  double band_max_z_m = 0.9;          ///< upper end: height of the robot
  double metric_min_height_m = 0.10;  ///< lower end of the metric obstacle band
  bool local_floor = true;     ///< heights are above the floor as it is found, see LocalFloor
  double metric_slope = 0.01;  ///< growth of that end with z-depth, for attitude error [m/m]
  double depth_edge_ratio =
      0.05;  ///< a pixel this much (relative) behind a neighbour is discarded; 0: off
};

/// How pixels become votes and votes a decision.
struct VoteParams {
  std::string votes = "frame";  ///< "pixel": one vote a pixel; "frame": one vote a voxel a frame
  std::string column =
      "worst";         ///< "sum": counts of the column are summed; "worst": its worst voxel decides
  int count_cap = 10;  ///< sliding cap of n_safe + n_unsafe; 0: none
  double tau = 0.5;    ///< a cell is safe when n_safe / (n_safe + n_unsafe) >= tau
  bool metric_layer = true;   ///< points in the metric band are unsafe whatever the predicates say
  int metric_min_points = 3;  ///< points a voxel needs in one frame for that
  bool free_space_clearing = true;  ///< a voxel seen through loses one unsafe vote
  /// Unsafe votes that a moving thing left lose half their weight in this time; 0: never forgotten.
  /// Heeded only where unknown ground is unsafe.
  double mobile_half_life_s = 2.0;
};

/// The instance memory and the regions it makes.
struct InstanceParams {
  /// Never instances; classes of ON are added.
  std::vector<std::string> surface_classes = {"floor",         "carpet",    "hallway", "sidewalk",
                                              "sidewalk_ramp", "crosswalk", "path",    "road",
                                              "parking_lot",   "driveway",  "patio"};
  /// What moves by itself: as the ontology has it. All other classes are at rest.
  std::vector<std::string> mobile_classes = {"forklift",
                                             "automated_guided_vehicle",
                                             "crane",
                                             "excavator",
                                             "scissor_lift",
                                             "robot_arm",
                                             "lawn_mower",
                                             "car",
                                             "truck",
                                             "bus",
                                             "train",
                                             "motorcycle",
                                             "person",
                                             "child",
                                             "patient",
                                             "doctor",
                                             "wheelchair",
                                             "walking_frame",
                                             "stroller",
                                             "crowd",
                                             "cyclist",
                                             "jogger",
                                             "police_officer",
                                             "construction_worker",
                                             "dog",
                                             "cat",
                                             "animal"};
  /// One of them that no frame saw for so long is forgotten wherever it was; 0: never.
  double mobile_release_s = 20.0;
  int max_instances = 500;  ///< more are not held
  int min_points = 8;       ///< pixels an instance needs in one frame
  int min_frames = 2;       ///< frames that must have seen it before it makes regions
  int release_frames = 5;   ///< frames that must see its place empty before it is forgotten
  double match_distance_m =
      0.4;  ///< largest gap between a held footprint and a new one of the same instance
  double footprint_slack_m = 0.5;  ///< largest growth of a footprint beyond its largest single view
  double mobile_slack_m = 0.2;     ///< the same of what moves: its footprint follows
  double max_footprint_m = 2.0;    ///< larger footprints count as extended: cells instead of a hull
  double between_max_gap_m = 2.5;  ///< single-link distance of a cluster
  double between_min_thickness_m = 0.3;
  double default_radius_m = 1.0;  ///< of AROUND
  std::map<std::string, double> class_radius_m;
};

/// What the map keeps in memory while the robot walks on.
struct WindowParams {
  double keep_radius_m = 0.0;  ///< ground nearer than this stays in memory; 0: all of it
  std::string outside =
      "drop";            ///< what lies farther is forgotten ("drop") or kept in files ("disk")
  std::string tile_dir;  ///< existing folder for those files; not a parameter of its own
};

/// Everything the semantic map needs; validated by fromMap. Defaults are those of profile `core`.
struct SemanticMapParams {
  double resolution_m = 0.2;
  double window_m = 20.0;  ///< edge of the published, robot-centred window
  /// false: predicates and labels decide nothing; what depth does not show as an obstacle is safe
  bool semantics = true;
  std::string operators =
      "ground";        ///< "image": as printed in [CORE]; "ground": on held instances, in metres
  int kernel_px = 50;  ///< of the image-space AROUND
  bool unknown_is_unsafe = true;
  double initial_disc_radius_m = 1.5;  ///< safe prior around the robot's first position
  std::string distance =
      "border";  ///< "centre": between cell centres, as [CORE]; "border": to cell squares
  double slow_speed_mps = 0.2;  ///< speed cap inside regions of severity SLOW
  RangeParams range;
  VoteParams vote;
  InstanceParams instance;
  WindowParams window;

  bool usesImageOperators() const { return operators == "image"; }

  /// Reads the known keys; leaves finish() to the caller.
  /// @throws ParameterError bad type, out of bounds, or contradicting values.
  static SemanticMapParams fromReader(ParamReader* reader);
  /// @throws ParameterError as above, or an unknown key.
  static SemanticMapParams fromMap(const ParamMap& values);
};

/// What the node needs beside the map itself.
struct NodeParams {
  bool lockstep = false;
  std::string map_frame = "odom";
  std::string base_frame = "base_link";
  double slop_s = 0.02;  ///< largest stamp difference of depth and labels without lock-step
  int queue_size = 60;   ///< frames that may wait for their labels
  double octomap_period_s = 1.0;   ///< of the octomap topics
  bool ignore_distortion = false;  ///< take images as rectified whatever camera_info says
  bool rectify = false;            ///< rectify images whose camera_info has distortion
  double grid_period_s = 0.0;      ///< of whole occupancy grids; updates between them; 0: all whole
  std::string map_dir;             ///< where semantic_map/save writes; empty: core_maps in ROS_HOME
  std::string map_file;            ///< .ot file the map begins with; empty: none
  SemanticMapParams map;

  static NodeParams fromMap(const ParamMap& values);
};

}  // namespace core_perception
