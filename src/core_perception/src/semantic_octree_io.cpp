// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/semantic_octree_io.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>

namespace core_perception {
namespace {

constexpr double kFinest_m = 0.001, kCoarsest_m = 100.0;

struct Header {
  std::string id;
  double resolution_m = 0.0;
  size_t n_nodes = 0;
};

/// OctoMap's text before the nodes: comment lines, then id, size and res, up to the line "data".
Header readHeader(std::istream& stream) {
  constexpr int kMostLines = 100;
  Header header;
  std::string line, key;
  if (!std::getline(stream, line) || line.compare(0, 21, "# Octomap OcTree file") != 0)
    throw TreeError("no OctoMap .ot file: its first line is not '# Octomap OcTree file'");
  for (int i = 0; i < kMostLines && std::getline(stream, line); ++i) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    words >> key;
    if (key == "data") return header;
    if (key == "id") words >> header.id;
    if (key == "size") words >> header.n_nodes;
    if (key == "res") words >> header.resolution_m;
    if (!words) throw TreeError("the header has no value for " + key.substr(0, 20));
  }
  throw TreeError("the header has no line 'data'");
}

void checkResolution(double resolution_m) {
  if (resolution_m >= kFinest_m && resolution_m <= kCoarsest_m) return;  // false for NaN
  std::ostringstream text;
  text << "resolution " << resolution_m << " m, allowed " << kFinest_m << " to " << kCoarsest_m;
  throw TreeError(text.str());
}

std::unique_ptr<SemanticOcTree> readNodes(double resolution_m, std::istream& stream) {
  checkResolution(resolution_m);
  auto tree = std::make_unique<SemanticOcTree>(resolution_m);
  if (!tree->readData(stream)) throw TreeError("the nodes end early or are no SemanticOcTree");
  if (stream.peek() != std::istream::traits_type::eof())
    throw TreeError("bytes follow the last node");
  return tree;
}

std::string describeErrno(const std::string& what, const std::string& path) {
  return what + " " + path + ": " + std::strerror(errno);
}

bool writeAll(int file, const std::string& bytes) {
  size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::write(file, bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    done += static_cast<size_t>(n);
  }
  return ::fsync(file) == 0;
}

}  // namespace

std::unique_ptr<SemanticOcTree> readTree(std::istream& stream) {
  const Header header = readHeader(stream);
  if (header.id != "SemanticOcTree")
    throw TreeError("the file holds a " + header.id.substr(0, 40) + ", not a SemanticOcTree");
  checkResolution(header.resolution_m);
  if (header.n_nodes == 0) return std::make_unique<SemanticOcTree>(header.resolution_m);
  auto tree = readNodes(header.resolution_m, stream);
  if (tree->size() != header.n_nodes)
    throw TreeError("the header names " + std::to_string(header.n_nodes) + " nodes, there are " +
                    std::to_string(tree->size()));
  return tree;
}

std::unique_ptr<SemanticOcTree> readTreeFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw TreeError(describeErrno("cannot open", path));
  try {
    return readTree(file);
  } catch (const TreeError& error) {
    throw TreeError(path + ": " + error.what());
  }
}

std::unique_ptr<SemanticOcTree> treeFromMessage(double resolution_m,
                                                const std::vector<int8_t>& data) {
  checkResolution(resolution_m);
  if (data.empty()) return std::make_unique<SemanticOcTree>(resolution_m);
  std::istringstream stream(std::string(data.begin(), data.end()));
  return readNodes(resolution_m, stream);
}

void writeFileAtomically(const std::string& path, const std::string& bytes) {
  std::string temporary = path + ".XXXXXX";
  const int file = ::mkostemp(&temporary[0], O_CLOEXEC);
  if (file < 0) throw TreeError(describeErrno("cannot write", path));
  const bool written = writeAll(file, bytes) && ::fchmod(file, 0644) == 0;
  const bool closed = ::close(file) == 0;
  if (written && closed && ::rename(temporary.c_str(), path.c_str()) == 0) return;
  const std::string reason = describeErrno("cannot write", path);
  ::unlink(temporary.c_str());
  throw TreeError(reason);
}

}  // namespace core_perception
