// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string>

#include "core_perception/semantic_octree.h"

namespace core_perception {

/// The tree of parameter map_file.
/// @throws ParameterError it cannot be read, has another resolution, or stands for more than 20
/// million voxels: pruned, a file of a few bytes can stand for the whole world.
std::unique_ptr<SemanticOcTree> readSavedMap(const std::string& path, double resolution_m);

}  // namespace core_perception
