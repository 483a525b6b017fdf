// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <limits>
#include <map>
#include <set>
#include <string>
#include <vector>

namespace core_perception {

/// One value of a parameter tree, free of ROS: what YAML can hold.
struct ParamValue {
  enum class Kind { kBool, kInt, kDouble, kString, kList, kStruct, kOther };
  Kind kind = Kind::kOther;
  bool flag = false;
  double number = 0.0;  ///< of kInt and kDouble
  std::string text;     ///< of kString
  std::vector<ParamValue> list;
  std::map<std::string, ParamValue> members;

  static ParamValue ofBool(bool value);
  static ParamValue ofInt(int value);
  static ParamValue ofDouble(double value);
  static ParamValue ofString(const std::string& value);
  /// For messages: 0.5, true, "text", list, struct.
  std::string toText() const;
};

using ParamMap = std::map<std::string, ParamValue>;

/// Inclusive bounds of a number.
struct Bounds {
  double lowest = -std::numeric_limits<double>::infinity();
  double highest = std::numeric_limits<double>::infinity();
};

/// Reads named values out of a ParamMap into fields that hold the defaults; a missing key keeps the
/// default. Every read throws ParameterError on a wrong type or a value out of bounds; so does
/// finish() on a key nobody read.
class ParamReader {
 public:
  explicit ParamReader(const ParamMap& values) : values_(values) {}

  /// A finite number within bounds; an integer literal is accepted.
  void read(const std::string& key, double* field, const Bounds& bounds);
  /// A whole number within bounds; 2.0 is refused.
  void read(const std::string& key, int* field, const Bounds& bounds);
  void read(const std::string& key, bool* field);
  /// Any non-empty text, or one of `allowed` where that is not empty.
  void read(const std::string& key, std::string* field,
            const std::vector<std::string>& allowed = {});
  /// Any text, the empty one too.
  void readText(const std::string& key, std::string* field);
  void read(const std::string& key, std::vector<std::string>* field);
  void read(const std::string& key, std::map<std::string, double>* field, const Bounds& bounds);
  /// @throws ParameterError naming the first key that was not read, and listing those that exist.
  void finish() const;

 private:
  const ParamValue* find(const std::string& key);

  const ParamMap& values_;
  std::set<std::string> known_;
};

}  // namespace core_perception
