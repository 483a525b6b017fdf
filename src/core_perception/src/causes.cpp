// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/causes.h"

#include <algorithm>

namespace core_perception {

uint16_t CauseTable::intern(const std::string& rule, const std::string& class_name) {
  const auto key = std::make_pair(rule, class_name);
  const auto it = numbers_.find(key);
  if (it != numbers_.end()) return it->second;
  if (causes_.size() >= kNoCause) return kNoCause;
  const auto number = static_cast<uint16_t>(causes_.size());
  const bool mobile = std::count(mobile_classes_.begin(), mobile_classes_.end(), class_name) > 0;
  causes_.push_back(Cause{rule, class_name, 0, mobile});
  numbers_.emplace(key, number);
  return number;
}

void CauseTable::clear() {
  numbers_.clear();
  causes_.clear();
}

}  // namespace core_perception
