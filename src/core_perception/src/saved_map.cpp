// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/saved_map.h"

#include <cmath>
#include <sstream>

#include "core_perception/exceptions.h"
#include "core_perception/semantic_octree_io.h"
#include "core_perception/tree_snapshot.h"

namespace core_perception {
namespace {

void checkFits(const SemanticOcTree& saved, double resolution_m) {
  if (std::abs(saved.getResolution() - resolution_m) > 1e-9) {
    std::ostringstream text;
    text << "it has " << saved.getResolution() << " m, not " << resolution_m;
    throw TreeError(text.str());
  }
  constexpr double kMostVoxels = 2e7;  // some 1 GB
  double n_voxels = 0.0;
  forEachLeaf(takeSnapshot(saved),
              [&n_voxels](const SnapshotLeaf& leaf) { n_voxels += std::pow(leaf.edge(), 3); });
  if (n_voxels > kMostVoxels) throw TreeError("it stands for more than 20 million voxels");
}

}  // namespace

std::unique_ptr<SemanticOcTree> readSavedMap(const std::string& path, double resolution_m) {
  try {
    std::unique_ptr<SemanticOcTree> saved = readTreeFile(path);
    checkFits(*saved, resolution_m);
    return saved;
  } catch (const TreeError& error) {
    throw ParameterError("map_file", path,
                         std::string("a saved map of resolution_m (") + error.what() + ")");
  }
}

}  // namespace core_perception
