// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <iosfwd>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "core_perception/semantic_octree.h"

namespace core_perception {

/// A file or a message is no SemanticOcTree, or cannot be written. what() is one line.
class TreeError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Tree of an .ot stream. Stricter than AbstractOcTree::read, which takes files of any class: the
/// header must name SemanticOcTree, a resolution in [0.001, 100] m and the number of nodes that
/// follow, and nothing may follow them.
/// @throws TreeError
std::unique_ptr<SemanticOcTree> readTree(std::istream& stream);
/// The same for a file. @throws TreeError
std::unique_ptr<SemanticOcTree> readTreeFile(const std::string& path);
/// Tree of a message with id "SemanticOcTree", checked in the same way; no bytes are an empty tree.
/// @throws TreeError
std::unique_ptr<SemanticOcTree> treeFromMessage(double resolution_m,
                                                const std::vector<int8_t>& data);

/// Writes a file whole or not at all: into a new file beside it, which then takes its name.
/// @throws TreeError
void writeFileAtomically(const std::string& path, const std::string& bytes);

}  // namespace core_perception
