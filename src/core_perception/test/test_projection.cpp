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

std::set<int> collectColumns(const Frame& frame, const RangeParams& range) {
  cv::Mat metres;
  convertToMetres(frame.depth, &metres);
  std::set<int> columns;
  Projection(frame, range).forEachPoint(metres, [&](const PixelPoint& p) { columns.insert(p.u); });
  return columns;
}

TEST(Projection, agrees_with_the_pinhole_equations) {
  const Frame frame = makeFrame(cv::Mat(320, 500, CV_32FC1, cv::Scalar(5.0f)));
  cv::Mat metres;
  convertToMetres(frame.depth, &metres);
  const Projection projection(frame, RangeParams());
  int n = 0;
  projection.forEachPoint(metres, [&](const PixelPoint& p) {
    const Eigen::Vector3d camera((p.u - 250.0) / 274.9 * 5.0, (p.v - 160.0) / 376.7 * 5.0, 5.0);
    const Eigen::Vector3d expected = frame.T_map_camera * camera - frame.T_map_camera.translation();
    ASSERT_NEAR((expected - Eigen::Vector3d(p.dx_m, p.dy_m, p.dz_m)).norm(), 0.0, 1e-5);
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
  projection.forEachPoint(metres, [&](const PixelPoint& p) {
    farthest_m = std::max(farthest_m, static_cast<double>(std::hypot(p.dx_m, p.dy_m)));
    VoxelTally* tally = votes.touch(p.dx_m, p.dy_m, p.dz_m);
    ASSERT_NE(tally, nullptr);
    ++tally->n_safe;
  });
  EXPECT_GT(farthest_m, 9.4);
  uint32_t counted = 0;
  for (const uint32_t touched : votes.touched()) {
    counted += votes.tally(touched).n_safe;
    const VoxelIndex voxel = votes.indexOf(touched);
    EXPECT_EQ(votes.find(voxel), &votes.tally(touched));
  }
  EXPECT_EQ(counted, 500u * 320u);
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
