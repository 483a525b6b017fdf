// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include "core_perception/params.h"

namespace core_perception {
namespace bench {

/// Parameters of the semantic_map node from a file of one "KEY KIND VALUE..." a line:
///
///     bool 0|1     int N     double X     string TEXT     list WORD...     map NAME X NAME X...
///
/// @throws std::runtime_error the file, @throws ParameterError a value.
SemanticMapParams readParams(const std::string& path);

}  // namespace bench
}  // namespace core_perception
