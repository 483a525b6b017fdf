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

/// A frame cannot be used. reason() is a stable code in lower snake case, what() the same in words.
class FrameError : public std::runtime_error {
 public:
  FrameError(const std::string& reason, const std::string& detail)
      : std::runtime_error(reason + ": " + detail), reason_(reason) {}
  const std::string& reason() const { return reason_; }

 private:
  std::string reason_;
};

}  // namespace core_perception
