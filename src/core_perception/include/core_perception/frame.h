// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Geometry>
#include <boost/align/aligned_allocator.hpp>
#include <cstdint>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "core_perception/geometry2d.h"

namespace core_perception {

/// Pinhole intrinsics of an image of this size; pixel (u, v) is centred at the integer:
///     x = z (u - cx) / fx,  y = z (v - cy) / fy        Source: [CORE] implementation details.
struct Camera {
  double fx_px = 0.0, fy_px = 0.0, cx_px = 0.0, cy_px = 0.0;
  int width_px = 0, height_px = 0;
};

/// What a value of the label image stands for.
struct LabelClass {
  uint16_t id = 0;
  std::string class_name;
};

/// A pose that may lie anywhere in memory: frames are kept in containers, and what a vector
/// instruction of another width would ask of them must not reach whoever links this library.
using Pose = Eigen::Transform<double, 3, Eigen::Isometry, Eigen::DontAlign>;

/// Everything the map needs to know about one instant. Images are not copied.
struct Frame {
  double stamp_s = 0.0;
  Camera camera;
  cv::Mat depth;   ///< CV_32FC1 [m] or CV_16UC1 [mm], along the optical axis
  cv::Mat labels;  ///< CV_16UC1, same size, 0 = none
  std::vector<LabelClass> classes;
  std::vector<std::string>
      classes_evaluated;  ///< looked for by the segmenter; others are not known to be absent
  Pose T_map_camera = Pose::Identity();  ///< optical frame at stamp_s
  Point2 p_map_base;                     ///< robot at stamp_s
};

/// Intrinsics for the same view at another image size.
Camera scaleCamera(const Camera& camera, int width_px, int height_px);

/// Length of the longest ray of the image per metre of depth.
double computeLongestRay(const Camera& camera);

/// @throws FrameError image_empty, image_type, image_size, labels_invalid, camera_invalid,
/// stamp_invalid or pose_invalid.
void checkFrame(const Frame& frame);

/// Loops over the pixels of a row work on whole blocks where they may: of those whose length is a
/// multiple of this compilers make vector instructions alone, with nothing left over.
constexpr int kBlock_px = 16;
inline int blockBegin(int pixel) { return pixel & ~(kBlock_px - 1); }
inline int blockEnd(int pixel) { return blockBegin(pixel + kBlock_px - 1); }

/// A value for every pixel of a row; a block of floats lies within one line of the cache.
template <typename T>
using PixelRow = std::vector<T, boost::alignment::aligned_allocator<T, kBlock_px * sizeof(float)>>;

/// Pixels around a depth image that may be read too, and hold 0.
constexpr int kDepthMargin_px = 2;

/// Depth in metres as CV_32FC1; whatever is NaN, infinite, zero or negative becomes 0.
/// @param metres becomes the inner part of a larger image with a margin of kDepthMargin_px pixels
/// of 0, on the right beyond the end of the last block; memory of the last call is used again
/// where the size is the same.
void convertToMetres(const cv::Mat& depth, cv::Mat* metres);
/// The same in parts, for who reads a row while it lies in the cache: the image, of which no row is
/// valid, and one row.
void makeMetres(const cv::Mat& depth, cv::Mat* metres);
void convertRowToMetres(const cv::Mat& depth, int v, cv::Mat* metres);

}  // namespace core_perception
