// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace core_perception {

/// Why a cell is unsafe. rule is a predicate such as "BETWEEN(traffic_cone)", or one of the words
/// below.
struct Cause {
  std::string rule;
  std::string class_name;
  uint32_t instance_id = 0;  ///< 0 for none
  bool mobile = false;       ///< the class moves by itself
};

constexpr char kMetricRule[] = "METRIC";     ///< obstacle seen by depth
constexpr char kNotSafeRule[] = "NOT_SAFE";  ///< no safe predicate holds there
constexpr char kSavedRule[] = "SAVED_MAP";   ///< unsafe in the map that was loaded
constexpr char kUnknownRule[] = "UNKNOWN";   ///< never seen
constexpr uint16_t kNoCause = 65535;

/// Numbers for (rule, class) pairs, stable until clear().
class CauseTable {
 public:
  /// @param mobile_classes those that move by themselves.
  explicit CauseTable(const std::vector<std::string>& mobile_classes = {})
      : mobile_classes_(mobile_classes) {}

  /// Number of the pair; kNoCause when the table is full (65535 pairs: class names come from
  /// outside).
  uint16_t intern(const std::string& rule, const std::string& class_name);
  const Cause& at(uint16_t index) const { return causes_[index]; }
  /// Whether a cause is of a class that moves; no index that was not given is.
  bool isMobile(uint16_t index) const { return index < causes_.size() && causes_[index].mobile; }
  size_t size() const { return causes_.size(); }
  void clear();

 private:
  std::vector<std::string> mobile_classes_;
  std::map<std::pair<std::string, std::string>, uint16_t> numbers_;
  std::vector<Cause> causes_;
};

}  // namespace core_perception
