// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sensor_msgs/distortion_models.h>

#include <boost/make_shared.hpp>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <random>

#include "core_perception/exceptions.h"
#include "core_perception/ros/conversions.h"
#include "octomap_client.h"

namespace core_perception {
namespace {

sensor_msgs::CameraInfo makeInfo(uint32_t width, uint32_t height) {
  sensor_msgs::CameraInfo info;
  info.width = width;
  info.height = height;
  info.K = {520.0, 0.0, 319.5, 0.0, 525.0, 241.5, 0.0, 0.0, 1.0};
  info.P = {500.0, 0.0, 310.5, 0.0, 0.0, 505.0, 245.5, 0.0, 0.0, 0.0, 1.0, 0.0};
  return info;
}

sensor_msgs::CameraInfo makeDistorted() {
  sensor_msgs::CameraInfo info = makeInfo(640, 480);
  info.distortion_model = "plumb_bob";
  info.D = {-0.2, 0.05, 0.001, -0.001, 0.0};
  return info;
}

template <typename Pixel>
sensor_msgs::Image makeImage(const std::string& encoding, uint32_t width, uint32_t height,
                             const std::function<Pixel(uint32_t, uint32_t)>& valueAt) {
  sensor_msgs::Image image;
  image.header.frame_id = "camera";
  image.header.stamp = ros::Time(5);
  image.encoding = encoding;
  image.width = width;
  image.height = height;
  image.step = width * static_cast<uint32_t>(sizeof(Pixel));
  image.data.resize(image.step * height);
  for (uint32_t v = 0; v < height; ++v) {
    for (uint32_t u = 0; u < width; ++u) {
      const Pixel value = valueAt(u, v);
      std::memcpy(&image.data[v * image.step + u * sizeof(Pixel)], &value, sizeof(Pixel));
    }
  }
  return image;
}

struct Messages {
  sensor_msgs::Image depth = makeImage<float>("32FC1", 64, 48, [](uint32_t u, uint32_t v) {
    return 1.0f + 0.01f * static_cast<float>(u) + 0.001f * static_cast<float>(v);
  });
  sensor_msgs::Image labels = makeImage<uint16_t>(
      "mono16", 64, 48, [](uint32_t u, uint32_t) { return static_cast<uint16_t>(u / 8 + 1); });
  sensor_msgs::CameraInfo info = makeInfo(640, 480);
  core_msgs::LabelInfo label_info;

  Frame toFrame(bool ignore_distortion = false, Rectifier* rectifier = nullptr) const {
    FrameMessages messages;
    messages.depth = boost::make_shared<sensor_msgs::Image>(depth);
    messages.labels = boost::make_shared<sensor_msgs::Image>(labels);
    messages.camera_info = boost::make_shared<sensor_msgs::CameraInfo>(info);
    messages.label_info = boost::make_shared<core_msgs::LabelInfo>(label_info);
    Frame frame = frameFromMessages(messages, ignore_distortion, rectifier);
    frame.depth = frame.depth.clone();  // the messages go out of scope
    frame.labels = frame.labels.clone();
    return frame;
  }
  /// "" when they are taken.
  std::string reason(Rectifier* rectifier = nullptr) const {
    try {
      toFrame(false, rectifier);
    } catch (const FrameError& error) {
      EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
      return error.reason();
    }
    return "";
  }
};

TEST(Conversions, depth_is_taken_in_metres_and_in_millimetres) {
  Messages m;
  EXPECT_EQ(m.toFrame().depth.type(), CV_32FC1);
  EXPECT_FLOAT_EQ(m.toFrame().depth.at<float>(2, 10), 1.102f);
  for (const char* encoding : {"16UC1", "mono16"}) {
    m.depth = makeImage<uint16_t>(
        encoding, 64, 48, [](uint32_t u, uint32_t) { return static_cast<uint16_t>(1000 + u); });
    cv::Mat metres;
    convertToMetres(m.toFrame().depth, &metres);
    EXPECT_FLOAT_EQ(metres.at<float>(3, 10), 1.01f) << encoding;
  }
}

TEST(Conversions, rows_may_be_padded) {
  Messages m;
  sensor_msgs::Image padded = m.depth;
  padded.step += 16;
  padded.data.assign(padded.step * padded.height, 0);
  for (uint32_t v = 0; v < padded.height; ++v)
    std::memcpy(&padded.data[v * padded.step], &m.depth.data[v * m.depth.step], m.depth.step);
  const cv::Mat expected = m.toFrame().depth;
  m.depth = padded;
  EXPECT_EQ(cv::countNonZero(m.toFrame().depth != expected), 0);
}

TEST(Conversions, every_unusable_image_is_refused_with_its_reason) {
  const auto reasonWith = [](const std::function<void(Messages*)>& spoil) {
    Messages m;
    spoil(&m);
    return m.reason();
  };
  EXPECT_EQ(reasonWith([](Messages*) {}), "");
  EXPECT_EQ(reasonWith([](Messages* m) { m->depth.encoding = "rgb8"; }), "image_encoding");
  EXPECT_EQ(reasonWith([](Messages* m) { m->depth.encoding = "64FC1"; }), "image_encoding");
  EXPECT_EQ(reasonWith([](Messages* m) { m->depth.encoding = ""; }), "image_encoding");
  EXPECT_EQ(reasonWith([](Messages* m) { m->labels.encoding = "mono8"; }), "image_encoding");
  EXPECT_EQ(reasonWith([](Messages* m) { m->labels.encoding = "32SC1"; }), "image_encoding");
  EXPECT_EQ(reasonWith([](Messages* m) { m->depth.is_bigendian = 1; }), "image_encoding");
  EXPECT_EQ(reasonWith([](Messages* m) { m->labels.is_bigendian = 1; }), "image_encoding");
  EXPECT_EQ(reasonWith([](Messages* m) { m->depth.data.pop_back(); }), "image_size");
  EXPECT_EQ(reasonWith([](Messages* m) { m->depth.data.clear(); }), "image_size");
  EXPECT_EQ(reasonWith([](Messages* m) { m->depth.step = 7; }), "image_size");
  EXPECT_EQ(reasonWith([](Messages* m) { m->labels.height = 0xffffffffu; }), "image_size");
  EXPECT_EQ(reasonWith([](Messages* m) { m->labels.width = 32; }), "image_size");
  EXPECT_EQ(reasonWith([](Messages* m) { m->labels.height = m->depth.height = 0; }), "image_size");
  EXPECT_EQ(reasonWith([](Messages* m) { m->labels.header.frame_id = "other"; }), "frame_id");
  EXPECT_EQ(
      reasonWith([](Messages* m) { m->depth.header.frame_id = m->labels.header.frame_id = ""; }),
      "frame_id");
  EXPECT_EQ(reasonWith([](Messages* m) { m->info.header.frame_id = "other"; }), "frame_id");
  EXPECT_EQ(reasonWith([](Messages* m) {
              m->depth.header.frame_id = "/camera";
              m->info.header.frame_id = "/camera";
            }),
            "")
      << "recordings of the time of tf have slashes";
  EXPECT_EQ(reasonWith([](Messages* m) { m->info.width = 0; }), "camera_invalid");
  EXPECT_EQ(reasonWith([](Messages* m) { m->info.width = 900; }), "camera_invalid");
  EXPECT_EQ(reasonWith([](Messages* m) { m->info.height = 0xffffffffu; }), "camera_invalid");
  EXPECT_EQ(reasonWith([](Messages* m) { m->info = makeDistorted(); }), "distorted");
}

TEST(Conversions, intrinsics_follow_the_size_of_the_image) {
  const Camera half = cameraFromMessage(makeInfo(640, 480), 320, 240, false);
  EXPECT_DOUBLE_EQ(half.fx_px, 260.0);
  EXPECT_DOUBLE_EQ(half.cx_px, 159.5);
  EXPECT_DOUBLE_EQ(half.cy_px, 120.5);
}

/// Where a ray of the full sensor meets an image that shows a part of it, binned: the border of
/// the part is the border of pixel 0.
double partPixel(double full_px, uint32_t offset, uint32_t binning) {
  return (full_px + 0.5 - offset) / binning - 0.5;
}

TEST(Conversions, region_of_interest_and_binning_show_the_same_rays) {
  sensor_msgs::CameraInfo info = makeInfo(641, 480);
  info.roi.x_offset = 101;
  info.roi.y_offset = 40;
  info.roi.width = 301;
  info.roi.height = 200;
  for (const uint32_t bin_x : {0u, 1u, 2u, 3u}) {
    for (const uint32_t bin_y : {1u, 4u}) {
      info.binning_x = bin_x;
      info.binning_y = bin_y;
      const uint32_t bx = std::max(bin_x, 1u), by = bin_y;
      const int width = static_cast<int>(301 / bx), height = static_cast<int>(200 / by);
      const Camera part = cameraFromMessage(info, width, height, false);
      EXPECT_EQ(part.width_px, width);
      EXPECT_EQ(part.height_px, height);
      for (const double ray : {-0.4, 0.0, 0.3}) {
        EXPECT_NEAR(part.fx_px * ray + part.cx_px, partPixel(520.0 * ray + 319.5, 101, bx), 1e-9);
        EXPECT_NEAR(part.fy_px * ray + part.cy_px, partPixel(525.0 * ray + 241.5, 40, by), 1e-9);
      }
    }
  }
  info.roi = sensor_msgs::RegionOfInterest();  // binning alone
  info.binning_x = info.binning_y = 2;
  EXPECT_NEAR(cameraFromMessage(info, 320, 240, false).cx_px, partPixel(319.5, 0, 2), 1e-9);
}

TEST(Conversions, part_of_the_sensor_that_does_not_fit_is_refused) {
  sensor_msgs::CameraInfo info = makeInfo(640, 480);
  info.roi.width = 320;
  info.roi.height = 240;
  EXPECT_NO_THROW(cameraFromMessage(info, 320, 240, false));
  EXPECT_THROW(cameraFromMessage(info, 640, 480, false), FrameError) << "not the part it names";
  EXPECT_THROW(cameraFromMessage(info, 160, 120, false), FrameError) << "nor scaled";
  info.roi.x_offset = 321;
  EXPECT_THROW(cameraFromMessage(info, 320, 240, false), FrameError) << "beyond the sensor";
  info.roi.x_offset = 0xffffffffu;
  EXPECT_THROW(cameraFromMessage(info, 320, 240, false), FrameError);
  info.roi = sensor_msgs::RegionOfInterest();
  info.roi.x_offset = 10;
  EXPECT_THROW(cameraFromMessage(info, 640, 480, false), FrameError) << "offset without size";
  info.roi = sensor_msgs::RegionOfInterest();
  info.binning_x = info.binning_y = 0xffffffffu;
  EXPECT_THROW(cameraFromMessage(info, 640, 480, false), FrameError);
}

TEST(Conversions, rectified_images_of_a_distorted_camera_are_seen_through_p) {
  sensor_msgs::CameraInfo info = makeDistorted();
  EXPECT_THROW(cameraFromMessage(info, 640, 480, false), FrameError);
  EXPECT_DOUBLE_EQ(cameraFromMessage(info, 640, 480, true).fx_px, 500.0);
  EXPECT_DOUBLE_EQ(cameraFromMessage(info, 640, 480, true).cy_px, 245.5);
  info.P.assign(0.0);  // not filled in
  EXPECT_DOUBLE_EQ(cameraFromMessage(info, 640, 480, true).fx_px, 520.0);
  EXPECT_DOUBLE_EQ(cameraFromMessage(makeInfo(640, 480), 640, 480, true).fx_px, 520.0);
}

TEST(Conversions, distorted_images_are_rectified_on_demand) {
  Messages m;
  const Messages undistorted;
  m.info = makeDistorted();
  Rectifier rectifier;
  const Frame frame = m.toFrame(false, &rectifier);
  EXPECT_DOUBLE_EQ(frame.camera.fx_px, 52.0);
  const Distortion lens{-0.2, 0.05, 0.001, -0.001, 0.0, 0.0, 0.0, 0.0};
  const cv::Mat expected = Rectifier().rectify(frame.camera, lens, undistorted.toFrame().depth);
  EXPECT_EQ(cv::countNonZero(frame.depth != expected), 0);
  EXPECT_GT(cv::countNonZero(frame.depth != undistorted.toFrame().depth), 500);
  EXPECT_EQ(frame.labels.type(), CV_16UC1);
  // Images without distortion stay what they are.
  EXPECT_EQ(
      cv::countNonZero(undistorted.toFrame(false, &rectifier).depth != undistorted.toFrame().depth),
      0);
}

TEST(Conversions, lenses_that_cannot_be_rectified_are_refused_in_words) {
  Rectifier rectifier;
  const auto reasonWith = [&](const std::string& model, const std::vector<double>& d) {
    Messages m;
    m.info.distortion_model = model;
    m.info.D = d;
    return m.reason(&rectifier);
  };
  EXPECT_EQ(reasonWith("plumb_bob", {0.1, 0.0, 0.0, 0.0}), "");
  EXPECT_EQ(reasonWith("rational_polynomial", {0.1, 0, 0, 0, 0, 0.1, 0, 0}), "");
  EXPECT_EQ(reasonWith("rational_polynomial", {0.1, 0, 0, 0, 0, 0.1, 0, 0, 0, 0, 0, 0}), "");
  EXPECT_EQ(reasonWith("rational_polynomial", {0.1, 0, 0, 0, 0, 0.1, 0, 0, 1e-3, 0, 0, 0}),
            "distorted");
  EXPECT_EQ(reasonWith("equidistant", {0.1, 0.0, 0.0, 0.0}), "distorted");
  EXPECT_EQ(reasonWith("fisheye", {0.1, 0.0, 0.0, 0.0}), "distorted");
  EXPECT_EQ(reasonWith("", {0.1, 0.0, 0.0, 0.0, 0.0}), "distorted");
  EXPECT_EQ(reasonWith("plumb_bob", {0.1, 0, 0, 0, 0, 0.1, 0, 0}), "distorted");
  EXPECT_EQ(reasonWith("plumb_bob", {std::nan(""), 0.0, 0.0, 0.0, 0.0}), "camera_invalid");
  EXPECT_EQ(reasonWith("equidistant", {0.0, 0.0, 0.0, 0.0}), "") << "no distortion at all";
}

class OctomapMessages : public testing::Test {
 protected:
  void SetUp() override {
    std::mt19937 random(3);
    for (int i = 0; i < 3000; ++i) {
      const auto draw = [&random](int from, unsigned n) {
        return static_cast<octomap::key_type>(from + static_cast<int>(random() % n));
      };
      tree_.touch(octomap::OcTreeKey(draw(32740, 50), draw(32750, 50), draw(32766, 8)))
          ->setCounts(random() % 5, random() % 5);
    }
    header_.frame_id = "map";
  }
  octomap_msgs::Octomap message(WireFormat format) {
    return octomapToMessage(format, header_, takeSnapshot(tree_));
  }

  SemanticOcTree tree_{0.2};
  std_msgs::Header header_;
};

TEST_F(OctomapMessages, stock_clients_read_every_leaf_of_the_class_they_expect) {
  const auto full = readMessage(message(WireFormat::kFull));
  const auto binary = readMessage(message(WireFormat::kBinary));
  const auto color = readMessage(message(WireFormat::kColor));
  const auto semantic = readMessage(message(WireFormat::kSemantic));
  auto& full_tree = dynamic_cast<octomap::OcTree&>(*full);
  auto& binary_tree = dynamic_cast<octomap::OcTree&>(*binary);
  auto& color_tree = dynamic_cast<octomap::ColorOcTree&>(*color);
  auto& semantic_tree = dynamic_cast<SemanticOcTree&>(*semantic);
  tree_.updateInnerOccupancy();
  EXPECT_TRUE(semantic_tree == tree_);
  size_t n = 0;
  for (auto it = tree_.begin_leafs(); it != tree_.end_leafs(); ++it, ++n) {
    const bool unsafe = it->n_unsafe() >= it->n_safe();
    const octomap::point3d centre = it.getCoordinate();
    ASSERT_NE(full_tree.search(centre), nullptr);
    EXPECT_EQ(full_tree.search(centre)->getValue(), it->getValue());
    EXPECT_EQ(binary_tree.isNodeOccupied(binary_tree.search(centre)), unsafe);
    const octomap::ColorOcTreeNode::Color shown = color_tree.search(centre)->getColor();
    EXPECT_EQ(shown.r > shown.g, unsafe);
  }
  for (octomap::AbstractOcTree* tree : {full.get(), binary.get(), color.get(), semantic.get()}) {
    EXPECT_EQ(tree->size(), tree_.size());
    EXPECT_EQ(tree->getResolution(), 0.2);
  }
  EXPECT_GT(n, 2000u);
}

TEST_F(OctomapMessages, ids_are_those_that_moveit_and_rviz_take) {
  EXPECT_TRUE(isTakenByMoveIt(message(WireFormat::kFull)));
  EXPECT_TRUE(isTakenByMoveIt(message(WireFormat::kBinary)));
  EXPECT_FALSE(isTakenByMoveIt(message(WireFormat::kSemantic)));
  EXPECT_TRUE(isTakenByRviz<octomap::OcTree>(message(WireFormat::kFull)));
  EXPECT_TRUE(isTakenByRviz<octomap::OcTree>(message(WireFormat::kBinary)));
  EXPECT_TRUE(isTakenByRviz<octomap::ColorOcTree>(message(WireFormat::kColor)));
  EXPECT_FALSE(isTakenByRviz<octomap::OcTree>(message(WireFormat::kSemantic)));
  EXPECT_FALSE(isTakenByRviz<octomap::ColorOcTree>(message(WireFormat::kSemantic)));
}

TEST_F(OctomapMessages, an_empty_map_is_an_empty_tree_to_every_client) {
  tree_.clear();
  for (const WireFormat format :
       {WireFormat::kFull, WireFormat::kBinary, WireFormat::kColor, WireFormat::kSemantic}) {
    const auto tree = readMessage(message(format));
    ASSERT_NE(tree, nullptr);
    EXPECT_EQ(tree->size(), 0u);
  }
}

TEST_F(OctomapMessages, centres_are_those_of_the_unsafe_voxels) {
  const sensor_msgs::PointCloud2 cloud = centersToMessage(header_, takeSnapshot(tree_));
  ASSERT_EQ(cloud.data.size(), static_cast<size_t>(cloud.width) * cloud.point_step);
  ASSERT_EQ(cloud.row_step, cloud.width * cloud.point_step);
  size_t n_unsafe = 0;
  for (auto it = tree_.begin_leafs(); it != tree_.end_leafs(); ++it)
    n_unsafe += it->n_unsafe() >= it->n_safe() ? 1 : 0;
  EXPECT_EQ(cloud.width, n_unsafe);
  for (uint32_t i = 0; i < cloud.width; ++i) {
    float xyz[3];
    std::memcpy(xyz, &cloud.data[i * cloud.point_step], sizeof(xyz));
    const SemanticOcTreeNode* node = tree_.search(xyz[0], xyz[1], xyz[2]);
    ASSERT_NE(node, nullptr);
    EXPECT_GE(node->n_unsafe(), node->n_safe());
    EXPECT_NEAR(std::remainder(xyz[0] - 0.1f, 0.2f), 0.0f, 1e-4f);
  }
}

TEST(GridMessage, every_cause_comes_with_rule_class_instance_and_motion) {
  SafetyGrid grid;
  grid.causes = {Cause{"METRIC", "", 0, false}, Cause{"AROUND(person)", "person", 7, true}};
  const core_msgs::SafetyGrid message =
      safetyGridToMessage(grid, std_msgs::Header(), ros::Time(3.0));
  ASSERT_EQ(message.causes.size(), 2u);
  EXPECT_EQ(message.causes[0].motion, core_msgs::UnsafeCause::STATIC);
  EXPECT_EQ(message.causes[1].motion, core_msgs::UnsafeCause::MOBILE);
  EXPECT_EQ(message.causes[1].rule, "AROUND(person)");
  EXPECT_EQ(message.causes[1].class_name, "person");
  EXPECT_EQ(message.causes[1].instance_id, 7u);
}

TEST(GridUpdate, grid_with_its_updates_equals_the_next_grid) {
  std::mt19937 random(4);
  nav_msgs::OccupancyGrid before;
  before.info.width = 13;
  before.info.height = 9;
  before.data.assign(13 * 9, -1);
  EXPECT_TRUE(makeUpdate(before, before).data.empty());
  for (int round = 0; round < 200; ++round) {
    nav_msgs::OccupancyGrid after = before;
    for (unsigned i = 0; i < 1 + random() % 4; ++i)
      after.data[random() % after.data.size()] = static_cast<int8_t>(random() % 101);
    const map_msgs::OccupancyGridUpdate update = makeUpdate(before, after);
    ASSERT_EQ(update.data.size(), static_cast<size_t>(update.width) * update.height);
    for (uint32_t y = 0; y < update.height; ++y) {
      for (uint32_t x = 0; x < update.width; ++x) {
        before.data[(update.y + static_cast<int>(y)) * 13 + update.x + static_cast<int>(x)] =
            update.data[y * update.width + x];
      }
    }
    ASSERT_EQ(before.data, after.data);
  }
}

TEST(Probability, is_one_in_regions_that_close_a_cell_and_that_of_the_votes_in_slow_ones) {
  SafetyGrid grid;
  grid.frame.width = 4;
  grid.frame.height = 1;
  grid.n_safe = {3, 3, 0, 0};
  grid.n_unsafe = {1, 1, 0, 0};
  grid.state = {CellState::kUnsafe, CellState::kSafe, CellState::kUnknown, CellState::kUnknown};
  grid.cause = {0, 1, 1, kNoCause};
  grid.causes = {Cause{"AROUND(person)", "person", 7, true},
                 Cause{"AROUND(forklift)", "forklift", 8, true}};
  const nav_msgs::OccupancyGrid message = probabilityToMessage(grid, std_msgs::Header());
  EXPECT_EQ(message.data, (std::vector<int8_t>{100, 25, -1, -1}));
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
