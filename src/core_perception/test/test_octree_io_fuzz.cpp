// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <octomap/OcTree.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <limits>
#include <memory>
#include <random>
#include <sstream>

#include "core_perception/octomap_wire.h"
#include "core_perception/semantic_octree_io.h"

namespace core_perception {
namespace {

unsigned seed() {
  const char* text = std::getenv("CORE_SEED");
  return text == nullptr ? 1u : static_cast<unsigned>(std::strtoul(text, nullptr, 10));
}

TreeSnapshot makeSnapshot(unsigned random_seed, int n_voxels) {
  SemanticOcTree tree(0.2);
  std::mt19937 random(random_seed);
  for (int i = 0; i < n_voxels; ++i) {
    const octomap::OcTreeKey key(static_cast<uint16_t>(32760 + random() % 10),
                                 static_cast<uint16_t>(32760 + random() % 10),
                                 static_cast<uint16_t>(32766 + random() % 5));
    tree.touch(key)->setCounts(random() % 2, 1);
  }
  tree.prune();
  return takeSnapshot(tree);
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

/// What the reader says of a file; empty when it takes it.
std::string complaintOf(const std::string& file) {
  std::istringstream stream(file);
  try {
    readTree(stream);
  } catch (const TreeError& error) {
    return error.what();
  }
  return "";
}

TEST(OctreeIo, round_trip_through_file_and_message_keeps_every_count) {
  const TreeSnapshot snapshot = makeSnapshot(3, 400);
  std::istringstream stream(formatFile(WireFormat::kSemantic, snapshot));
  const auto from_file = readTree(stream);
  EXPECT_EQ(takeSnapshot(*from_file).nodes, snapshot.nodes);
  EXPECT_EQ(from_file->getResolution(), 0.2);
  EXPECT_EQ(takeSnapshot(*treeFromMessage(0.2, snapshot.nodes)).nodes, snapshot.nodes);
  EXPECT_EQ(treeFromMessage(0.2, {})->size(), 0u);
  TreeSnapshot empty;
  empty.resolution_m = 1.0 / 3.0;
  std::istringstream empty_stream(formatFile(WireFormat::kSemantic, empty));
  const auto read = readTree(empty_stream);
  EXPECT_EQ(read->size(), 0u);
  EXPECT_EQ(read->getResolution(), 1.0 / 3.0);
}

TEST(OctreeIo, wrong_headers_are_refused_in_words) {
  const std::string good = formatFile(WireFormat::kSemantic, makeSnapshot(3, 50));
  ASSERT_EQ(complaintOf(good), "");
  const auto complaint = [&](const std::string& from, const std::string& to) {
    return complaintOf(replaced(good, from, to));
  };
  EXPECT_NE(complaint("# Octomap", "# Rocktomap").find("no OctoMap .ot file"), std::string::npos);
  EXPECT_NE(complaint("id SemanticOcTree", "id OcTree").find("holds a OcTree"), std::string::npos);
  EXPECT_NE(complaint("res 0.2", "res nan").find("no value for res"), std::string::npos);
  EXPECT_NE(complaint("res 0.2", "res -0.2").find("resolution -0.2"), std::string::npos);
  EXPECT_NE(complaint("res 0.2", "res 0").find("resolution 0"), std::string::npos);
  EXPECT_NE(complaint("res 0.2", "res 1e300").find("resolution 1e+300"), std::string::npos);
  EXPECT_NE(complaint("\ndata\n", "\ndada\n"), "");
  EXPECT_NE(complaint("size ", "size 9").find("the header names 9"), std::string::npos);
  EXPECT_NE(complaintOf(good + "x").find("bytes follow"), std::string::npos);
  EXPECT_NE(complaintOf("").find("no OctoMap .ot file"), std::string::npos);
  EXPECT_NE(complaintOf("# Octomap OcTree file\n").find("no line 'data'"), std::string::npos);
  EXPECT_THROW(treeFromMessage(std::nan(""), {}), TreeError);
  EXPECT_THROW(readTreeFile("/no/such/file.ot"), TreeError);
  EXPECT_THROW(readTreeFile("/"), TreeError);
}

/// A node as bytes.
std::string node(float value, uint32_t n_safe, uint32_t n_unsafe, uint8_t children) {
  std::string bytes(13, '\0');
  std::memcpy(&bytes[0], &value, 4);
  std::memcpy(&bytes[4], &n_safe, 4);
  std::memcpy(&bytes[8], &n_unsafe, 4);
  std::memcpy(&bytes[12], &children, 1);
  return bytes;
}

bool isTaken(const std::string& bytes) {
  std::istringstream stream(bytes);
  SemanticOcTree tree(0.2);
  const bool taken = static_cast<bool>(tree.readData(stream));
  EXPECT_EQ(tree.size(), tree.calcNumNodes());
  EXPECT_EQ(tree.getRoot() != nullptr, taken);
  return taken;
}

TEST(OctreeIo, impossible_nodes_leave_the_tree_empty) {
  const float value = static_cast<float>(std::log(1.5 / 0.5));
  const std::string leaf = node(value, 0, 1, 0), inner = node(value, 0, 0, 1);
  EXPECT_TRUE(isTaken(inner + leaf));
  EXPECT_FALSE(isTaken(inner));                          // the child is missing
  EXPECT_FALSE(isTaken(inner + leaf.substr(0, 12)));     // and its last byte
  EXPECT_FALSE(isTaken(node(value, 1, 0, 1) + leaf));    // counts in an inner node
  EXPECT_FALSE(isTaken(inner + node(-value, 0, 1, 0)));  // unsafe by its counts, free by its value
  EXPECT_FALSE(isTaken(inner + node(std::nanf(""), 0, 1, 0)));
  EXPECT_FALSE(isTaken(node(std::numeric_limits<float>::infinity(), 0, 0, 1) + leaf));
  std::string deep;
  for (int i = 0; i < 16; ++i) deep += inner;
  EXPECT_TRUE(isTaken(deep + leaf));
  EXPECT_FALSE(isTaken(deep + inner + leaf));  // level 17
  for (int i = 0; i < 1000000; ++i) deep += inner;
  EXPECT_FALSE(isTaken(deep));  // would exhaust the stack of OctoMap's reader
}

TEST(OctreeIo, reading_into_a_tree_that_is_not_empty_is_refused_and_changes_nothing) {
  const TreeSnapshot snapshot = makeSnapshot(3, 50);
  auto tree = treeFromMessage(0.2, snapshot.nodes);
  std::istringstream stream(std::string(snapshot.nodes.begin(), snapshot.nodes.end()));
  EXPECT_FALSE(tree->readData(stream));
  EXPECT_EQ(takeSnapshot(*tree).nodes, snapshot.nodes);
}

TEST(OctreeIo, every_truncation_is_refused) {
  const std::string good = formatFile(WireFormat::kSemantic, makeSnapshot(4, 60));
  for (size_t n = 0; n < good.size(); ++n) {
    ASSERT_NE(complaintOf(good.substr(0, n)), "") << n << " of " << good.size();
    std::istringstream stream(good.substr(0, n));
    const std::unique_ptr<octomap::AbstractOcTree> stock(octomap::AbstractOcTree::read(stream));
    if (stock != nullptr) {
      ASSERT_EQ(stock->size(), 0u) << n;
    }
  }
}

std::string mutate(std::string bytes, std::mt19937* random) {
  const int n_changes = 1 + static_cast<int>((*random)() % 4);
  for (int i = 0; i < n_changes && !bytes.empty(); ++i) {
    const size_t at = (*random)() % bytes.size();
    switch ((*random)() % 5) {
      case 0:
        bytes[at] = static_cast<char>((*random)());
        break;
      case 1:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << (*random)() % 8));
        break;
      case 2:
        bytes.erase(at, 1 + (*random)() % 20);
        break;
      case 3:
        bytes.insert(at, bytes.substr((*random)() % bytes.size(), (*random)() % 40));
        break;
      default:
        bytes.resize(at);
    }
  }
  return bytes;
}

TEST(OctreeIo, fuzzed_bytes_give_a_whole_tree_or_none) {
  std::mt19937 random(seed());
  int n_taken = 0;
  for (int i = 0; i < 20000; ++i) {
    const TreeSnapshot snapshot = makeSnapshot(random(), 1 + static_cast<int>(random() % 40));
    const std::string nodes(snapshot.nodes.begin(), snapshot.nodes.end());
    if (isTaken(mutate(nodes, &random))) ++n_taken;
    const std::string file = mutate(formatFile(WireFormat::kSemantic, snapshot), &random);
    complaintOf(file);
    std::istringstream stream(file);  // as any OctoMap program reads it
    const std::unique_ptr<octomap::AbstractOcTree> stock(octomap::AbstractOcTree::read(stream));
    if (const auto* tree = dynamic_cast<const SemanticOcTree*>(stock.get())) {
      ASSERT_EQ(tree->size(), tree->calcNumNodes());
    }
  }
  EXPECT_GT(n_taken, 100);  // some changes are harmless: the fuzzer reaches whole trees too
}

TEST(OctreeIo, a_file_is_written_whole_or_not_at_all) {
  char folder[] = "/tmp/octree_io_XXXXXX";
  ASSERT_NE(mkdtemp(folder), nullptr);
  const std::string path = std::string(folder) + "/map.ot";
  writeFileAtomically(path, "old");
  writeFileAtomically(path, formatFile(WireFormat::kSemantic, makeSnapshot(5, 50)));
  EXPECT_GT(readTreeFile(path)->size(), 0u);
  const std::string missing = std::string(folder) + "/missing/map.ot";
  EXPECT_THROW(writeFileAtomically(missing, "x"), TreeError);
  const std::string directory = std::string(folder) + "/directory";
  ASSERT_EQ(mkdir(directory.c_str(), 0755), 0);
  EXPECT_THROW(writeFileAtomically(directory, "x"), TreeError);
  EXPECT_EQ(rmdir(directory.c_str()), 0);
  EXPECT_EQ(unlink(path.c_str()), 0);
  EXPECT_EQ(rmdir(folder), 0) << "something was left behind";
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
