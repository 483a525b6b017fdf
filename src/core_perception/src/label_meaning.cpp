// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/label_meaning.h"

#include <algorithm>
#include <limits>

namespace core_perception {

LabelMeanings::LabelMeanings(const std::vector<std::string>& surface_classes)
    : surface_classes_(surface_classes), table_(65536) {}

bool LabelMeanings::isSurface(const std::string& class_name,
                              const std::vector<Predicate>& predicates) const {
  if (std::count(surface_classes_.begin(), surface_classes_.end(), class_name) > 0) return true;
  bool on = false, as_object = false;
  for (const Predicate& predicate : predicates) {
    if (predicate.class_name != class_name) continue;
    const bool is_on = predicate.spatial_operator == SpatialOperator::kOn;
    on = on || is_on;
    as_object = as_object || (!is_on && predicate.isUnsafe());
  }
  return on && !as_object;
}

LabelMeaning LabelMeanings::makeMeaning(const std::string& class_name,
                                        const std::vector<Predicate>& predicates,
                                        CauseTable* causes) const {
  bool safe = false, unsafe = false;
  std::string rule = kNotSafeRule;
  for (const Predicate& predicate : predicates) {
    if (predicate.class_name != class_name) continue;
    const bool own_pixels = predicate.spatial_operator == SpatialOperator::kOn ||
                            predicate.spatial_operator == SpatialOperator::kNear;
    if (own_pixels && predicate.isBarrier()) {
      unsafe = true;
      rule = formatRule(predicate);
    }
    safe = safe || (own_pixels && !predicate.isUnsafe());
  }
  LabelMeaning meaning;
  meaning.safe = safe && !unsafe;
  meaning.instance_slot = isSurface(class_name, predicates) ? -1 : 0;
  meaning.cause = causes->intern(rule, class_name);
  meaning.metric_cause = causes->intern(kMetricRule, class_name);
  return meaning;
}

void LabelMeanings::build(const std::vector<LabelClass>& classes,
                          const std::vector<Predicate>& predicates, CauseTable* causes) {
  const LabelMeaning unlabelled = [&] {
    LabelMeaning meaning;
    meaning.cause = causes->intern(kNotSafeRule, "");
    meaning.metric_cause = causes->intern(kMetricRule, "");
    return meaning;
  }();
  if (table_[0].cause != unlabelled.cause || table_[0].metric_cause != unlabelled.metric_cause) {
    std::fill(table_.begin(), table_.end(), unlabelled);
  }
  for (const uint16_t id : used_) table_[id] = unlabelled;
  used_.clear();
  constexpr size_t kMostSlots = std::numeric_limits<int16_t>::max();
  for (size_t i = 0; i < classes.size(); ++i) {
    const uint16_t id = classes[i].id;
    if (id == 0) continue;  // reserved for "no label"
    table_[id] = makeMeaning(classes[i].class_name, predicates, causes);
    if (table_[id].instance_slot == 0)
      table_[id].instance_slot = i < kMostSlots ? static_cast<int16_t>(i) : -1;
    used_.push_back(id);
  }
}

}  // namespace core_perception
