// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <limits>

#include "core_perception/exceptions.h"
#include "core_perception/params.h"

namespace core_perception {
namespace {

ParamValue makeList(const std::vector<ParamValue>& items) {
  ParamValue value;
  value.kind = ParamValue::Kind::kList;
  value.list = items;
  return value;
}

ParamValue makeTable(const ParamMap& members) {
  ParamValue value;
  value.kind = ParamValue::Kind::kStruct;
  value.members = members;
  return value;
}

/// The message of the error that this parameter raises, or "" for none.
std::string findError(const ParamMap& values) {
  try {
    NodeParams::fromMap(values);
  } catch (const ParameterError& error) {
    return error.what();
  }
  return "";
}

TEST(Params, nothing_given_is_profile_core) {
  const NodeParams p = NodeParams::fromMap({});
  EXPECT_EQ(p.map.operators, "ground");
  EXPECT_TRUE(p.map.unknown_is_unsafe);
  EXPECT_DOUBLE_EQ(p.map.range.range_min_m, 0.3);
}

TEST(Params, given_values_are_taken_and_integers_are_numbers) {
  const NodeParams p =
      NodeParams::fromMap({{"window_m", ParamValue::ofInt(10)},
                           {"lockstep", ParamValue::ofBool(true)},
                           {"surface_classes", makeList({ParamValue::ofString("ice")})},
                           {"class_radius_m", makeTable({{"person", ParamValue::ofDouble(1.2)}})}});
  EXPECT_DOUBLE_EQ(p.map.window_m, 10.0);
  EXPECT_TRUE(p.lockstep);
  EXPECT_EQ(p.map.instance.surface_classes, std::vector<std::string>{"ice"});
  EXPECT_DOUBLE_EQ(p.map.instance.class_radius_m.at("person"), 1.2);
}

TEST(Params, every_bad_value_is_refused_by_name) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  const std::vector<std::pair<std::string, ParamValue>> catalogue{
      {"resolution_m", ParamValue::ofDouble(0.0)},
      {"window_m", ParamValue::ofDouble(nan)},
      {"range_max_m", ParamValue::ofDouble(inf)},
      {"range_min_m", ParamValue::ofDouble(8.0)},
      {"band_min_z_m", ParamValue::ofDouble(1.0)},
      {"tree_min_z_m", ParamValue::ofDouble(0.0)},
      {"band_max_z_m", ParamValue::ofDouble(4.0)},
      {"metric_min_height_m", ParamValue::ofDouble(1.5)},
      {"metric_min_points", ParamValue::ofInt(0)},
      {"tau", ParamValue::ofDouble(1.5)},
      {"count_cap", ParamValue::ofInt(-1)},
      {"kernel_px", ParamValue::ofDouble(50.0)},
      {"operators", ParamValue::ofString("pixels")},
      {"votes", ParamValue::ofInt(1)},
      {"column", ParamValue::ofString("")},
      {"distance", ParamValue::ofString("Border")},
      {"lockstep", ParamValue::ofString("true")},
      {"unknown_is_unsafe", ParamValue::ofInt(1)},
      {"semantics", ParamValue::ofString("false")},
      {"map_frame", ParamValue::ofString("")},
      {"slop_s", ParamValue::ofDouble(-0.1)},
      {"queue_size", ParamValue::ofInt(0)},
      {"octomap_period_s", ParamValue::ofDouble(0.0)},
      {"rectify", ParamValue::ofInt(1)},
      {"grid_period_s", ParamValue::ofDouble(-1.0)},
      {"map_dir", ParamValue::ofBool(true)},
      {"map_file", ParamValue::ofDouble(1.0)},
      {"keep_radius_m", ParamValue::ofDouble(-1.0)},
      {"keep_radius_m", ParamValue::ofDouble(19.0)},
      {"outside", ParamValue::ofString("forget")},
      {"min_frames", ParamValue::ofInt(0)},
      {"release_frames", ParamValue::ofBool(true)},
      {"surface_classes", ParamValue::ofString("floor")},
      {"class_radius_m", makeTable({{"person", ParamValue::ofDouble(-1.0)}})},
      {"between_max_gap_m", makeList({})},
      {"mobile_half_life_s", ParamValue::ofDouble(-1.0)},
      {"mobile_classes", ParamValue::ofString("person")},
      {"mobile_release_s", ParamValue::ofDouble(inf)},
      {"mobile_slack_m", ParamValue::ofDouble(-0.1)},
      {"max_instances", ParamValue::ofInt(0)},
      {"no_such_key", ParamValue::ofInt(1)},
      {"Tau", ParamValue::ofDouble(0.5)},
  };
  for (const auto& entry : catalogue) {
    const std::string error = findError({entry});
    EXPECT_EQ(error.find(entry.first), 0u) << entry.first << ": " << error;
    EXPECT_NE(error.find("got "), std::string::npos) << error;
    EXPECT_NE(error.find("allowed "), std::string::npos) << error;
    EXPECT_EQ(error.find('\n'), std::string::npos) << error;
  }
}

TEST(Params, values_that_contradict_each_other_are_refused) {
  const ParamValue sum = ParamValue::ofString("sum");
  EXPECT_EQ(findError({{"column", sum}}).find("free_space_clearing: got true"), 0u);
  EXPECT_EQ(findError({{"column", sum}, {"free_space_clearing", ParamValue::ofBool(false)}}), "");
  const ParamValue no = ParamValue::ofBool(false);
  EXPECT_EQ(findError({{"semantics", no}, {"metric_layer", no}}).find("metric_layer: got false"),
            0u);
  EXPECT_EQ(findError({{"semantics", no}}), "");
  const ParamValue yes = ParamValue::ofBool(true);
  EXPECT_EQ(findError({{"rectify", yes}, {"ignore_distortion", yes}}).find("rectify: got true"),
            0u);
  EXPECT_EQ(findError({{"rectify", yes}}), "");
  const ParamValue file = ParamValue::ofString("/maps/hall.ot");
  const ParamMap in_odom{{"map_file", file}, {"map_frame", ParamValue::ofString("robot1/odom")}};
  EXPECT_EQ(findError(in_odom).find("map_file: got /maps/hall.ot"), 0u) << findError(in_odom);
  EXPECT_EQ(findError({{"map_file", file}, {"map_frame", ParamValue::ofString("map")}}), "");
  EXPECT_EQ(findError({{"map_file", ParamValue::ofString("")}}), "");
  const ParamValue radius = ParamValue::ofDouble(30.0);
  EXPECT_EQ(findError({{"keep_radius_m", radius}}), "");
  EXPECT_EQ(findError({{"keep_radius_m", radius}, {"unknown_is_unsafe", no}})
                .find("unknown_is_unsafe: got false"),
            0u);
  // The scratch volume is counted in 32 bits.
  const ParamMap fine{{"resolution_m", ParamValue::ofDouble(0.02)},
                      {"range_max_m", ParamValue::ofDouble(4.0)},
                      {"tree_max_z_m", ParamValue::ofDouble(3.5)}};
  EXPECT_EQ(findError(fine).find("tree_max_z_m: got 3.5"), 0u) << findError(fine);
}

TEST(Params, wrong_item_of_a_list_is_refused) {
  EXPECT_NE(findError({{"surface_classes", makeList({ParamValue::ofInt(3)})}}), "");
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
