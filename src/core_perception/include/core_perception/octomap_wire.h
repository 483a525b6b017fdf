// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core_perception/tree_snapshot.h"

namespace core_perception {

/// What an octomap message can hold.
enum class WireFormat {
  kFull,      ///< id "OcTree", log-odds of being unsafe: any OctoMap client
  kBinary,    ///< id "OcTree", occupied (unsafe) or free (safe): any OctoMap client
  kColor,     ///< id "ColorOcTree", red unsafe, green safe; all occupied, so that RViz draws every
              ///< voxel
  kSemantic,  ///< id "SemanticOcTree", with counts: clients that link core_semantic_octree
};

/// Class name under which OctoMap's factory reads the bytes.
std::string idOf(WireFormat format);

/// Bytes of octomap_msgs/Octomap.data; empty for an empty tree.
std::vector<int8_t> serialise(WireFormat format, const TreeSnapshot& snapshot);
std::vector<int8_t> serialise(WireFormat format, const SemanticOcTree& tree);

/// The bytes of a file: of kSemantic an .ot with every count, of kBinary a .bt for octovis and
/// other OctoMap programs. No other format is a file of its own.
std::string formatFile(WireFormat format, const TreeSnapshot& snapshot);

}  // namespace core_perception
