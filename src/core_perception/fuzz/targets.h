// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <vector>

#include "chain.h"

namespace core_perception {
namespace fuzz {

using Input = std::vector<uint8_t>;
using Target = void (*)(const uint8_t* data, size_t size, Tally* tally);

/// One to four frames, most with a spoiled field of image, camera_info, label_info or pose, through
/// the queue or past it.
void runFrames(const uint8_t* data, size_t size, Tally* tally);
/// Well-formed frames under well-formed and spoiled constraints.
void runConstraints(const uint8_t* data, size_t size, Tally* tally);
/// Messages from raw bytes, see makeWireInput.
void runWire(const uint8_t* data, size_t size, Tally* tally);

struct NamedTarget {
  std::string name;
  Target run;
  std::vector<Input> seeds;
};

/// All targets with their first inputs, which are made, not stored.
const std::vector<NamedTarget>& targets();
/// nullptr for a name there is none of.
const NamedTarget* findTarget(const std::string& name);

}  // namespace fuzz
}  // namespace core_perception
