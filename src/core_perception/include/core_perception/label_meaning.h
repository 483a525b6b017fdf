// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core_perception/causes.h"
#include "core_perception/frame.h"
#include "core_perception/predicates.h"

namespace core_perception {

/// What a label value means for the votes of its pixels.
struct LabelMeaning {
  bool safe = false;           ///< its class is safe ground
  int16_t instance_slot = -1;  ///< index into Frame::classes when it may be an instance, else -1
  uint16_t cause = kNoCause;   ///< of an unsafe pixel at floor level
  uint16_t metric_cause = kNoCause;  ///< of a pixel in the metric obstacle band
};

/// Meaning of every label value of a frame under the constraints in force.
///
/// A class is safe ground when ON or NEAR of it is safe and none of the two is unsafe with severity
/// STOP; everything else is not safe, label 0 and values that Frame::classes does not list
/// included. Safe AROUND and BETWEEN never make safe ground.
class LabelMeanings {
 public:
  explicit LabelMeanings(const std::vector<std::string>& surface_classes);

  void build(const std::vector<LabelClass>& classes, const std::vector<Predicate>& predicates,
             CauseTable* causes);
  /// A class is a surface, never an instance, when it is listed, or when ON is applied to it and no
  /// unsafe NEAR, AROUND or BETWEEN speaks of it: one more predicate must not undo a region.
  bool isSurface(const std::string& class_name, const std::vector<Predicate>& predicates) const;
  const LabelMeaning& operator[](uint16_t label) const { return table_[label]; }

 private:
  LabelMeaning makeMeaning(const std::string& class_name, const std::vector<Predicate>& predicates,
                           CauseTable* causes) const;

  std::vector<std::string> surface_classes_;
  std::vector<LabelMeaning> table_;  ///< 65536 entries
  std::vector<uint16_t> used_;       ///< those that differ from table_[0]
};

}  // namespace core_perception
