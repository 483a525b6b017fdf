// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <opencv2/core.hpp>
#include <string>

#include "core_perception/instance_memory.h"
#include "core_perception/local_floor.h"
#include "core_perception/projection.h"

namespace core_perception {

/// Looks at the place of a held object in one frame.
///
/// The place is EMPTY when the whole footprint lies in the image and within range, at least 60 % of
/// the pixels whose ray meets the floor inside it show floor there, and next to no point inside it
/// stands up or carries the object's class. It is OCCUPIED when some points do; OTHER when nearly
/// all of these carry the label of another listed class although the segmenter looked for the
/// object's own. Otherwise it is HIDDEN. An object no higher than the metric band (a puddle, a
/// cable) can only be told from the floor by its label: its place is empty only where the segmenter
/// looked for the class.
class PlaceProbe {
 public:
  /// The arguments must outlive the probe.
  PlaceProbe(const Frame& frame, const cv::Mat& metres, const Projection& projection,
             const RangeParams& range, const LocalFloor& floor)
      : frame_(frame), metres_(metres), projection_(projection), range_(range), floor_(floor) {}

  PlaceView look(const HeldInstance& held) const;

 private:
  struct Evidence {
    int n_expected = 0;    ///< pixels whose ray meets the floor inside the footprint
    int n_floor = 0;       ///< pixels that show floor inside the footprint
    int n_standing = 0;    ///< pixels that show something else inside the footprint
    int n_other = 0;       ///< those of them that carry the label of another class
    float floor_m = 0.0f;  ///< height of the local floor in its middle
  };

  /// Pixel of a place at a height above the local floor, as Projection::project.
  Eigen::Vector3d projectAbove(const Point2& place, double height_m) const;
  /// Of what hangs over the floor; true for what stands on it.
  bool isBodyInView(const HeldInstance& held) const;
  bool isInView(const Polygon& place) const;
  cv::Rect findPixels(const Polygon& place, double top_z_m) const;
  enum class Owner { kNone, kSame, kOther };
  Owner findOwner(uint16_t label, const std::string& class_name) const;
  Evidence gather(const Polygon& place, const cv::Rect& pixels,
                  const std::string& class_name) const;
  void judgePixel(const Polygon& place, int u, int v, Owner owner, Evidence* evidence) const;

  const Frame& frame_;
  const cv::Mat& metres_;
  const Projection& projection_;
  const RangeParams& range_;
  const LocalFloor& floor_;
};

}  // namespace core_perception
