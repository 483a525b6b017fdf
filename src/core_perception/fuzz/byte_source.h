// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>

namespace core_perception {
namespace fuzz {

/// Values out of the bytes of one fuzz input, in order. Beyond the end everything is 0, and 0
/// stands for the ordinary choice everywhere, so that the empty input is a valid frame.
class ByteSource {
 public:
  ByteSource(const uint8_t* data, size_t size) : at_(data), left_(size) {}

  size_t left() const { return left_; }
  const uint8_t* at() const { return at_; }
  void skip(size_t n) {
    n = std::min(n, left_);
    at_ += n;
    left_ -= n;
  }

  template <typename T>
  T raw() {
    T value{};
    const size_t n = std::min(sizeof(T), left_);
    if (n > 0) std::memcpy(&value, at_, n);
    skip(n);
    return value;
  }

  /// 0 … n - 1.
  uint32_t pick(uint32_t n) { return n <= 256 ? raw<uint8_t>() % n : raw<uint16_t>() % n; }
  bool flag() { return (raw<uint8_t>() & 1) != 0; }
  /// middle at 0, uniform within half of it.
  double around(double middle, double half) { return middle + half * (raw<int16_t>() / 32768.0); }

  /// A number of those that break arithmetic, or any bit pattern at all.
  double specialNumber() {
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    static const double kValues[] = {
        0.0,          -0.0,          1.0,         -1.0,
        1e-3,         65535.0,       5000.0,      5000.1,
        -6553.6,      1e-300,        -1e-300,     std::numeric_limits<double>::denorm_min(),
        1e-39,        1e38,          -1e38,       1e300,
        -1e300,       kInfinity,     -kInfinity,  std::numeric_limits<double>::quiet_NaN(),
        2147483648.0, -2147483649.0, 4294967296.0};
    constexpr uint32_t kN = sizeof(kValues) / sizeof(kValues[0]);
    const uint32_t i = pick(kN + 1);
    return i < kN ? kValues[i] : raw<double>();
  }

  uint32_t specialCount() {
    static const uint32_t kValues[] = {0,     1,     2,           3,           16384,
                                       16385, 65536, 2147483647u, 2147483648u, 4294967295u};
    constexpr uint32_t kN = sizeof(kValues) / sizeof(kValues[0]);
    const uint32_t i = pick(kN + 1);
    return i < kN ? kValues[i] : raw<uint32_t>();
  }

 private:
  const uint8_t* at_;
  size_t left_;
};

}  // namespace fuzz
}  // namespace core_perception
