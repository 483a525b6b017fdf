// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/octomap_wire.h"

#include <cstring>
#include <sstream>

namespace core_perception {
namespace {

using Bytes = std::vector<int8_t>;

void append(const void* data, size_t size, Bytes* bytes) {
  const auto* begin = static_cast<const int8_t*>(data);
  bytes->insert(bytes->end(), begin, begin + size);
}

void appendValue(const SemanticOcTreeNode& node, Bytes* bytes) {
  const float value = node.getValue();
  append(&value, sizeof(value), bytes);
}

void appendColor(const SemanticOcTreeNode& node, Bytes* bytes) {
  constexpr float kOccupied = 1.0f;
  constexpr uint8_t kUnsafe[] = {220, 50, 40};
  constexpr uint8_t kSafe[] = {60, 180, 75};
  append(&kOccupied, sizeof(kOccupied), bytes);
  append(node.getValue() >= 0.0f ? kUnsafe : kSafe, 3, bytes);
}

/// OctoMap's pre-order: payload, then one bit for each child that follows.
template <typename AppendPayload>
void appendNode(const SemanticOcTree& tree, const SemanticOcTreeNode* node,
                AppendPayload appendPayload, Bytes* bytes) {
  appendPayload(*node, bytes);
  uint8_t children = 0;
  for (unsigned i = 0; i < 8; ++i) {
    if (tree.nodeChildExists(node, i)) children = static_cast<uint8_t>(children | (1u << i));
  }
  append(&children, 1, bytes);
  for (unsigned i = 0; i < 8; ++i) {
    if ((children & (1u << i)) != 0)
      appendNode(tree, tree.getNodeChild(node, i), appendPayload, bytes);
  }
}

Bytes toBytes(const std::ostringstream& stream) {
  const std::string text = stream.str();
  return Bytes(text.begin(), text.end());
}

}  // namespace

std::string idOf(WireFormat format) {
  switch (format) {
    case WireFormat::kColor:
      return "ColorOcTree";
    case WireFormat::kSemantic:
      return "SemanticOcTree";
    default:
      return "OcTree";
  }
}

std::vector<int8_t> serialise(WireFormat format, SemanticOcTree* tree) {
  Bytes bytes;
  if (tree->getRoot() == nullptr) return bytes;
  tree->updateInnerOccupancy();
  std::ostringstream stream;
  switch (format) {
    case WireFormat::kFull:
      appendNode(*tree, tree->getRoot(), appendValue, &bytes);
      return bytes;
    case WireFormat::kColor:
      appendNode(*tree, tree->getRoot(), appendColor, &bytes);
      return bytes;
    case WireFormat::kBinary:
      tree->writeBinaryData(stream);
      return toBytes(stream);
    case WireFormat::kSemantic:
      tree->writeData(stream);
      return toBytes(stream);
  }
  return bytes;
}

}  // namespace core_perception
