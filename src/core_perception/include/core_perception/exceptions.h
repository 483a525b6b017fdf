// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <stdexcept>
#include <string>

namespace core_perception {

/// A parameter has a wrong type or value, or is not known. what() reads "key: got X, allowed Y".
class ParameterError : public std::invalid_argument {
 public:
  ParameterError(const std::string& key, const std::string& got, const std::string& allowed)
      : std::invalid_argument(key + ": got " + got + ", allowed " + allowed) {}
};

/// Text from outside, for one line of a diagnostic: control characters, bytes beyond ASCII and all
/// after the first 60 are shown as "?" and "...".
inline std::string toPrintable(const std::string& text) {
  constexpr size_t kLongest = 60;
  std::string line = text.substr(0, kLongest);
  for (char& c : line) {
    if (c < ' ' || c > '~') c = '?';
  }
  return text.size() > kLongest ? line + "..." : line;
}

/// A frame cannot be used. reason() is a stable code in lower snake case, what() the same in words,
/// in one line.
class FrameError : public std::runtime_error {
 public:
  FrameError(const std::string& reason, const std::string& detail)
      : std::runtime_error(reason + ": " + detail), reason_(reason) {}
  const std::string& reason() const { return reason_; }

 private:
  std::string reason_;
};

}  // namespace core_perception
