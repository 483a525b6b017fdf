// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <set>

#include "core_perception/frame_votes.h"
#include "core_perception/projection.h"
#include "scene.h"

namespace core_perception {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinite = std::numeric_limits<float>::infinity();

Frame makeFrame(const cv::Mat& depth) {
  Frame frame;
  frame.stamp_s = 1.0;
  frame.camera = scaleCamera(Scene::camera(), depth.cols, depth.rows);
  frame.depth = depth;
  frame.labels = cv::Mat::zeros(depth.size(), CV_16UC1);
  frame.T_map_camera = Scene::pose(1.0, -2.0, 0.7);
  return frame;
}

/// A pixel with depth, and its point relative to the camera.
struct PixelPoint {
  int u, v;
  Eigen::Vector3f d_m;
};

template <typename Visitor>
void forEachPoint(const Projection& projection, const cv::Mat& metres, Visitor visit) {
  PointRow row;
  for (int v = 0; v < metres.rows; ++v) {
    projection.projectRow(metres, v, &row);
    for (int u = row.first; u < row.end; ++u) {
      if (row.depth_m[u] > 0.0f)
        visit(PixelPoint{u, v, Eigen::Vector3f(row.dx_m[u], row.dy_m[u], row.dz_m[u])});
    }
  }
}

std::set<int> collectColumns(const Frame& frame, const RangeParams& range) {
  cv::Mat metres;
  convertToMetres(frame.depth, &metres);
  std::set<int> columns;
  forEachPoint(Projection(frame, range), metres, [&](const PixelPoint& p) { columns.insert(p.u); });
  return columns;
}

TEST(Projection, every_depth_in_millimetres_is_divided_to_the_last_bit) {
  cv::Mat depth(256, 256, CV_16UC1), metres;
  for (int i = 0; i < 1 << 16; ++i) depth.at<uint16_t>(i / 256, i % 256) = static_cast<uint16_t>(i);
  convertToMetres(depth, &metres);
  volatile const float units_per_m = 1000.0f;  // a division at run time
  for (int i = 0; i < 1 << 16; ++i)
    ASSERT_EQ(metres.at<float>(i / 256, i % 256), static_cast<float>(i) / units_per_m) << i;
}

TEST(Projection, agrees_with_the_pinhole_equations) {
  const Frame frame = makeFrame(cv::Mat(320, 500, CV_32FC1, cv::Scalar(5.0f)));
  cv::Mat metres;
  convertToMetres(frame.depth, &metres);
  const Projection projection(frame, RangeParams());
  int n = 0;
  forEachPoint(projection, metres, [&](const PixelPoint& p) {
    const Eigen::Vector3d camera((p.u - 250.0) / 274.9 * 5.0, (p.v - 160.0) / 376.7 * 5.0, 5.0);
    const Eigen::Vector3d expected = frame.T_map_camera * camera - frame.T_map_camera.translation();
    ASSERT_NEAR((expected - p.d_m.cast<double>()).norm(), 0.0, 1e-5);
    const Eigen::Vector3d pixel = projection.project(frame.T_map_camera * camera);
    ASSERT_NEAR(pixel.x(), p.u, 1e-6);
    ASSERT_NEAR(pixel.y(), p.v, 1e-6);
    ASSERT_NEAR(pixel.z(), 5.0, 1e-9);
    ++n;
  });
  EXPECT_EQ(n, 500 * 320) << "no column at the right edge may be lost";
}

TEST(Projection, depth_that_is_none_or_out_of_range_is_discarded) {
  RangeParams range;
  range.depth_edge_ratio = 0.0;
  const cv::Mat depth = (cv::Mat_<float>(1, 9) << kNan, 0.0f, kInfinite, -kInfinite, -2.0f, 0.29f,
                         0.3f, 7.0f, 7.001f);
  EXPECT_EQ(collectColumns(makeFrame(depth), range), (std::set<int>{6, 7}));
  const cv::Mat mm = (cv::Mat_<uint16_t>(1, 5) << 0, 299, 301, 6999, 7001);
  EXPECT_EQ(collectColumns(makeFrame(mm), range), (std::set<int>{2, 3}));
}

TEST(Projection, far_side_of_a_depth_edge_is_dropped_and_a_thin_pole_kept) {
  const cv::Mat depth = (cv::Mat_<float>(1, 7) << 5.0f, 5.0f, 4.0f, 3.0f, 5.0f, 5.0f, 5.1f);
  EXPECT_EQ(collectColumns(makeFrame(depth), RangeParams()), (std::set<int>{0, 3, 5, 6}));
}

TEST(Projection, whole_reach_of_the_camera_fits_the_scratch_volume) {
  // z-depth 7 m at the image corner lies 9.5 m away on the ground.
  const Frame frame = makeFrame(cv::Mat(320, 500, CV_32FC1, cv::Scalar(7.0f)));
  cv::Mat metres;
  convertToMetres(frame.depth, &metres);
  const Projection projection(frame, RangeParams());
  FrameVotes votes(0.2, -10.0, 10.0);
  votes.start(projection.p_map_camera(), projection.reach_m());
  double farthest_m = 0.0;
  forEachPoint(projection, metres, [&](const PixelPoint& p) {
    farthest_m = std::max(farthest_m, static_cast<double>(p.d_m.head<2>().norm()));
  });
  PointRow row;
  PixelRow<int32_t> voxels;
  for (int v = 0; v < metres.rows; ++v) {
    projection.projectRow(metres, v, &row);
    votes.locate(row, FloorBand(), &voxels);
    for (int u = 0; u < metres.cols; ++u) {
      const int32_t exact = votes.locatePoint(projection.computePoint(u, v, 7.0), 7.0, FloorBand());
      ASSERT_GT(exact, FrameVotes::kNoVoxel);
      ASSERT_TRUE(voxels[u] == exact || voxels[u] == FrameVotes::kUndecided) << u << " " << v;
      FrameVotes::RowCounter(&votes, 1).add(exact, kSafeVote, 1, kNoCause);
    }
  }
  EXPECT_GT(farthest_m, 9.4);
  uint32_t counted = 0;
  for (const VoxelTally& tally : votes.tallies()) {
    counted += tally.n_safe();
    EXPECT_EQ(votes.find(votes.indexOf(tally.voxel)), &tally);
  }
  EXPECT_EQ(counted, 500u * 320u);
}

/// What single precision decides must be what double precision says; it may leave a few open.
TEST(Projection, no_point_lands_in_a_wrong_voxel) {
  FloorBand floor;
  floor.camera_height_m = 0.65f;
  floor.min_height_m = -0.15f;
  floor.metric_min_height_m = 0.10f;
  floor.metric_slope = 0.01f;
  FrameVotes votes(0.2, -1.0, 3.0);
  int n_undecided = 0;
  for (int round = 0; round < 20; ++round) {
    cv::Mat depth(320, 500, CV_32FC1);
    cv::randu(depth, 0.3, 7.0);
    Frame frame = makeFrame(depth);
    frame.T_map_camera = Scene::pose(37.3 * round, -91.7 * round, 0.3 * round);
    RangeParams range;
    range.depth_edge_ratio = 0.0;
    const Projection projection(frame, range);
    cv::Mat metres;
    convertToMetres(frame.depth, &metres);
    votes.start(projection.p_map_camera(), projection.reach_m());
    PointRow row;
    PixelRow<int32_t> voxels;
    for (int v = 0; v < metres.rows; ++v) {
      projection.projectRow(metres, v, &row);
      votes.locate(row, floor, &voxels);
      for (int u = row.first; u < row.end; ++u) {
        n_undecided += voxels[u] == FrameVotes::kUndecided ? 1 : 0;
        if (voxels[u] == FrameVotes::kUndecided) continue;
        const double z_m = metres.ptr<float>(v)[u];
        ASSERT_EQ(voxels[u], votes.locatePoint(projection.computePoint(u, v, z_m), z_m, floor));
      }
    }
  }
  EXPECT_LT(n_undecided, 20 * 500 * 320 / 500);
}

TEST(Projection, millimetres_at_both_ends_of_the_range_are_within_it) {
  const cv::Mat mm = (cv::Mat_<uint16_t>(1, 4) << 299, 300, 7000, 7001);
  RangeParams range;
  range.depth_edge_ratio = 0.0;
  EXPECT_EQ(collectColumns(makeFrame(mm), range), (std::set<int>{1, 2}));
}

TEST(Projection, scaled_intrinsics_see_the_same_rays) {
  const Camera half = scaleCamera(Scene::camera(), 250, 160);
  const Camera full = Scene::camera();
  // The centre of pixel 10 of the half image is the corner between pixels 20 and 21 of the full
  // one.
  EXPECT_NEAR((10 - half.cx_px) / half.fx_px, (20.5 - full.cx_px) / full.fx_px, 1e-12);
  EXPECT_NEAR((7 - half.cy_px) / half.fy_px, (14.5 - full.cy_px) / full.fy_px, 1e-12);
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
