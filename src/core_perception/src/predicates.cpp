// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/predicates.h"

#include <algorithm>

namespace core_perception {

std::string formatRule(const Predicate& predicate) {
  static const char* const kNames[] = {"ON", "NEAR", "AROUND", "BETWEEN"};
  return std::string(kNames[static_cast<int>(predicate.spatial_operator)]) + "(" +
         predicate.class_name + ")";
}

bool isCancelled(const Predicate& predicate, const std::vector<Predicate>& all) {
  if (!predicate.isUnsafe() || predicate.spatial_operator != SpatialOperator::kBetween)
    return false;
  return std::any_of(all.begin(), all.end(), [&](const Predicate& other) {
    return !other.isUnsafe() && other.spatial_operator == SpatialOperator::kBetween &&
           other.class_name == predicate.class_name;
  });
}

}  // namespace core_perception
