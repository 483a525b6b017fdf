// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdio>
#include <exception>
#include <opencv2/core.hpp>

namespace core_perception {
namespace bench {

/// Runs a program on one thread; what it throws becomes one line and exit status 2.
inline int runProgram(const char* name, int (*run)(int, char**), int argc, char** argv) {
  cv::setNumThreads(1);
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", name, error.what());
    return 2;
  }
}

}  // namespace bench
}  // namespace core_perception
