// SPDX-License-Identifier: BSD-3-Clause
// Entry of clang's libFuzzer; CORE_FUZZ_TARGET is the name of the target.
#include "targets.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const core_perception::fuzz::Target run =
      core_perception::fuzz::findTarget(CORE_FUZZ_TARGET)->run;
  core_perception::fuzz::Tally tally;
  run(data, size, &tally);
  return 0;
}
