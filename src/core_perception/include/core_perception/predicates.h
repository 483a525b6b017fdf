// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <vector>

namespace core_perception {

/// Values equal those of core_msgs/Predicate. Source: [CORE] appendix, spatial operators.
enum class SpatialOperator : int { kOn = 0, kNear = 1, kAround = 2, kBetween = 3 };
enum class Verdict : int { kSafe = 0, kUnsafe = 1 };
enum class Severity : int { kStop = 0, kSlow = 1 };

/// A spatial operator applied to a class, with its verdict.
struct Predicate {
  SpatialOperator spatial_operator = SpatialOperator::kOn;
  std::string class_name;
  Verdict verdict = Verdict::kUnsafe;
  Severity severity = Severity::kStop;
  double radius_m = 0.0;                ///< of AROUND; 0 means the default of the class
  std::set<uint32_t> exempt_instances;  ///< numbers of held objects it does not speak of

  bool isUnsafe() const { return verdict == Verdict::kUnsafe; }
  bool isBarrier() const { return isUnsafe() && severity == Severity::kStop; }
};

/// What a reasoner said, and when it looked.
struct Constraints {
  double image_stamp_s = 0.0;  ///< 0 while no answer exists yet
  /// History of the map that exempt_instances count by, see SemanticMap::history_start_s; 0
  /// without.
  double instances_history_start_s = 0.0;
  std::vector<Predicate> predicates;

  bool isActive() const { return image_stamp_s > 0.0; }
};

/// "BETWEEN(traffic_cone)".
std::string formatRule(const Predicate& predicate);

/// Whether some SAFE predicate has this operator and class: a safe BETWEEN cancels an unsafe one on
/// the same class.
bool isCancelled(const Predicate& predicate, const std::vector<Predicate>& all);

}  // namespace core_perception
