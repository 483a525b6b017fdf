// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/octomap_wire.h"

#include <cstring>
#include <sstream>
#include <stdexcept>

namespace core_perception {
namespace {

using Bytes = std::vector<int8_t>;

constexpr size_t kFlatSize = TreeSnapshot::kNodeSize;

Bytes makeFull(const Bytes& nodes) {
  Bytes bytes(nodes.size() / kFlatSize * 5);
  int8_t* out = bytes.data();
  for (const int8_t* in = nodes.data(); in != nodes.data() + nodes.size(); in += kFlatSize) {
    std::memcpy(out, in, 4);
    out[4] = in[12];
    out += 5;
  }
  return bytes;
}

Bytes makeColor(const Bytes& nodes) {
  constexpr float kOccupied = 1.0f;
  constexpr uint8_t kUnsafe[] = {220, 50, 40};
  constexpr uint8_t kSafe[] = {60, 180, 75};
  Bytes bytes(nodes.size() / kFlatSize * 8);
  int8_t* out = bytes.data();
  for (const int8_t* in = nodes.data(); in != nodes.data() + nodes.size(); in += kFlatSize) {
    std::memcpy(out, &kOccupied, 4);
    std::memcpy(out + 4, FlatNode::load(in).value >= 0.0f ? kUnsafe : kSafe, 3);
    out[7] = in[12];
    out += 8;
  }
  return bytes;
}

/// OctoMap's two bits a child: 1 free, 2 occupied, 3 has children of its own.
void appendBinary(const int8_t** in, Bytes* bytes) {
  const size_t at = bytes->size();
  bytes->resize(at + 2);
  const uint8_t children = FlatNode::load(*in).children;
  *in += kFlatSize;
  unsigned bits = 0;
  for (unsigned i = 0; i < 8; ++i) {
    if ((children & (1u << i)) == 0) continue;
    const FlatNode child = FlatNode::load(*in);
    if (child.children != 0) {
      bits |= 3u << (2 * i);
      appendBinary(in, bytes);
    } else {
      bits |= (child.value >= 0.0f ? 2u : 1u) << (2 * i);
      *in += kFlatSize;
    }
  }
  (*bytes)[at] = static_cast<int8_t>(bits & 0xff);
  (*bytes)[at + 1] = static_cast<int8_t>(bits >> 8);
}

size_t countNodes(const TreeSnapshot& snapshot) { return snapshot.nodes.size() / kFlatSize; }

/// Text that reads back as the same number: OctoMap's six digits where they do.
std::string formatExactly(double value) {
  for (const int digits : {6, 17}) {
    std::ostringstream text;
    text.precision(digits);
    text << value;
    if (digits == 17 || std::stod(text.str()) == value) return text.str();
  }
  return "";
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

std::vector<int8_t> serialise(WireFormat format, const TreeSnapshot& snapshot) {
  if (snapshot.nodes.empty()) return {};
  switch (format) {
    case WireFormat::kFull:
      return makeFull(snapshot.nodes);
    case WireFormat::kColor:
      return makeColor(snapshot.nodes);
    case WireFormat::kBinary: {
      Bytes bytes;
      const int8_t* in = snapshot.nodes.data();
      appendBinary(&in, &bytes);
      return bytes;
    }
    case WireFormat::kSemantic:
      break;
  }
  return snapshot.nodes;
}

std::vector<int8_t> serialise(WireFormat format, const SemanticOcTree& tree) {
  return serialise(format, takeSnapshot(tree));
}

std::string formatFile(WireFormat format, const TreeSnapshot& snapshot) {
  const bool binary = format == WireFormat::kBinary;
  if (!binary && format != WireFormat::kSemantic) throw std::invalid_argument("no file format");
  std::ostringstream file;
  file << (binary ? "# Octomap OcTree binary file" : "# Octomap OcTree file") << "\nid "
       << idOf(format) << "\nsize " << countNodes(snapshot) << "\nres "
       << formatExactly(snapshot.resolution_m) << "\ndata\n";
  const Bytes bytes = serialise(format, snapshot);
  file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<long>(bytes.size()));
  return file.str();
}

}  // namespace core_perception
