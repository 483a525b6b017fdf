// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

#include "core_perception/exceptions.h"
#include "core_perception/semantic_map.h"

namespace core_perception {
namespace fuzz {

/// The code under test broke a promise. Not caught by anything but the driver.
class BrokenPromise : public std::logic_error {
 public:
  explicit BrokenPromise(const std::string& what) : std::logic_error(what) {}
};

/// @throws BrokenPromise unless it holds.
inline void require(bool holds, const char* promise) {
  if (!holds) throw BrokenPromise(promise);
}

/// Hash of everything a rejected frame must leave alone: grid, votes of the tree, objects,
/// predicates in force and the start of the history.
uint64_t computeDigest(SemanticMap* map);

/// What must hold after every frame that was added.
/// @throws BrokenPromise an index out of range, a number that is not finite, |h| above the diagonal
/// of the grid, a sign of h against the decision, votes above the cap, or a message that does not
/// fit the grid.
void checkMap(SemanticMap* map);

/// One line of printable text with a reason code in lower snake case.
void checkDiagnostic(const FrameError& error);

}  // namespace fuzz
}  // namespace core_perception
