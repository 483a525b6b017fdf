// SPDX-License-Identifier: BSD-3-Clause
#include <sensor_msgs/distortion_models.h>

#include <algorithm>
#include <cmath>

#include "core_perception/exceptions.h"
#include "core_perception/ros/conversions.h"

namespace core_perception {
namespace {

[[noreturn]] void refuseSize(const std::string& camera, int width_px, int height_px) {
  throw FrameError("camera_invalid", "camera_info is for " + camera + ", the images are " +
                                         std::to_string(width_px) + "x" +
                                         std::to_string(height_px));
}

/// Region of interest in full resolution, then binning, as sensor_msgs/CameraInfo has them. Such
/// an image must have just the size that follows.
Camera cropAndBin(const sensor_msgs::CameraInfo& info, Camera camera, int width_px, int height_px) {
  const sensor_msgs::RegionOfInterest& roi = info.roi;
  const uint32_t bin_x = std::max(info.binning_x, 1u), bin_y = std::max(info.binning_y, 1u);
  const uint32_t width = roi.width != 0 ? roi.width : info.width;
  const uint32_t height = roi.height != 0 ? roi.height : info.height;
  const bool inside = static_cast<uint64_t>(roi.x_offset) + width <= info.width &&
                      static_cast<uint64_t>(roi.y_offset) + height <= info.height;
  const std::string words = std::to_string(width) + "x" + std::to_string(height) + " at (" +
                            std::to_string(roi.x_offset) + ", " + std::to_string(roi.y_offset) +
                            ") binned " + std::to_string(bin_x) + "x" + std::to_string(bin_y);
  if (!inside)
    throw FrameError("camera_invalid",
                     "the region of interest " + words + " reaches beyond the sensor of " +
                         std::to_string(info.width) + "x" + std::to_string(info.height));
  if (width / bin_x != static_cast<uint32_t>(width_px) ||
      height / bin_y != static_cast<uint32_t>(height_px))
    refuseSize(words, width_px, height_px);
  camera.cx_px -= roi.x_offset;
  camera.cy_px -= roi.y_offset;
  // The last columns may be too few for a pixel; those that are there have the full size.
  camera.width_px = width_px * static_cast<int>(bin_x);
  camera.height_px = height_px * static_cast<int>(bin_y);
  return camera;
}

}  // namespace

bool hasDistortion(const sensor_msgs::CameraInfo& info) {
  return std::any_of(info.D.begin(), info.D.end(), [](double d) { return d != 0.0; });
}

Camera makeCamera(const sensor_msgs::CameraInfo& info, int width_px, int height_px,
                  bool rectified) {
  if (info.width == 0 || info.height == 0 || info.width > kLargest_px || info.height > kLargest_px)
    refuseSize(std::to_string(info.width) + "x" + std::to_string(info.height), width_px, height_px);
  const auto& roi = info.roi;
  Camera camera{rectified ? info.P[0] : info.K[0], rectified ? info.P[5] : info.K[4],
                rectified ? info.P[2] : info.K[2], rectified ? info.P[6] : info.K[5],
                static_cast<int>(info.width),      static_cast<int>(info.height)};
  const bool is_part = roi.x_offset != 0 || roi.y_offset != 0 || roi.width != 0 || roi.height != 0;
  if (is_part || info.binning_x > 1 || info.binning_y > 1) {
    if (rectified && roi.do_rectify)
      throw FrameError("camera_invalid", "a rectified region of interest is not supported");
    camera = cropAndBin(info, camera, width_px, height_px);
    return scaleCamera(camera, width_px, height_px);
  }
  const double shape =
      static_cast<double>(info.width) * height_px - static_cast<double>(info.height) * width_px;
  if (std::abs(shape) > 0.02 * info.width * height_px)
    refuseSize(std::to_string(info.width) + "x" + std::to_string(info.height), width_px, height_px);
  return scaleCamera(camera, width_px, height_px);
}

Camera cameraFromMessage(const sensor_msgs::CameraInfo& info, int width_px, int height_px,
                         bool ignore_distortion) {
  const bool distorted = hasDistortion(info);
  if (distorted && !ignore_distortion) {
    throw FrameError("distorted",
                     "camera_info has distortion; set rectify if the images are raw, or "
                     "ignore_distortion if they are rectified already");
  }
  // P speaks of rectified images, K of raw ones; P[0] is 0 where nobody filled it in.
  return makeCamera(info, width_px, height_px, distorted && info.P[0] != 0.0);
}

Distortion distortionFromMessage(const sensor_msgs::CameraInfo& info) {
  const std::vector<double>& d = info.D;
  const bool plumb_bob =
      info.distortion_model == sensor_msgs::distortion_models::PLUMB_BOB && d.size() <= 5;
  const bool rational =
      info.distortion_model == sensor_msgs::distortion_models::RATIONAL_POLYNOMIAL;
  if (hasDistortion(info) && !plumb_bob && !rational) {
    throw FrameError("distorted", "distortion model '" + toPrintable(info.distortion_model) +
                                      "' with " + std::to_string(d.size()) +
                                      " numbers cannot be rectified, allowed plumb_bob with up to "
                                      "5, rational_polynomial; rectify the images");
  }
  if (!std::all_of(d.begin(), d.end(), [](double k) { return std::isfinite(k); }))
    throw FrameError("camera_invalid", "camera_info has a distortion that is no number");
  if (d.size() > 8 && std::any_of(d.begin() + 8, d.end(), [](double k) { return k != 0.0; }))
    throw FrameError("distorted", "thin prism and tilt cannot be rectified; rectify the images");
  const auto at = [&d](size_t i) { return i < d.size() ? d[i] : 0.0; };
  return Distortion{at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7)};
}

}  // namespace core_perception
