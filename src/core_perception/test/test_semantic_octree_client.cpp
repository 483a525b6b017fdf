// SPDX-License-Identifier: BSD-3-Clause
// What another package does: links core_semantic_octree and OctoMap, nothing else of ours and no
// ROS, and reads a file and the payload of a message through OctoMap's factory.
#include <core_perception/semantic_octree.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <sstream>
#include <string>

namespace {

/// One voxel, written byte by byte as the README says: 16 inner nodes on the way, then the leaf.
std::string makePayload(unsigned n_safe, unsigned n_unsafe) {
  const float value = static_cast<float>(std::log((n_unsafe + 0.5) / (n_safe + 0.5)));
  std::string bytes;
  const auto add = [&bytes](const void* data, size_t size) {
    bytes.append(static_cast<const char*>(data), size);
  };
  for (int depth = 0; depth <= 16; ++depth) {
    const unsigned counts[] = {depth == 16 ? n_safe : 0u, depth == 16 ? n_unsafe : 0u};
    const unsigned char children = depth == 16 ? 0 : depth == 0 ? 128 : 1;
    add(&value, 4);
    add(counts, 8);
    add(&children, 1);
  }
  return bytes;
}

void expectVoxel(octomap::AbstractOcTree* tree) {
  auto* semantic = dynamic_cast<core_perception::SemanticOcTree*>(tree);
  ASSERT_NE(semantic, nullptr);
  const core_perception::SemanticOcTreeNode* node = semantic->search(0.1, 0.1, 0.1);
  ASSERT_NE(node, nullptr);
  EXPECT_EQ(node->n_safe(), 3u);
  EXPECT_EQ(node->n_unsafe(), 8u);
  EXPECT_EQ(semantic->getNumLeafNodes(), 1u);
}

TEST(SemanticOctreeClient, message_is_read_through_the_factory) {
  std::unique_ptr<octomap::AbstractOcTree> tree(
      octomap::AbstractOcTree::createTree("SemanticOcTree", 0.2));
  ASSERT_NE(tree, nullptr);
  std::stringstream stream(makePayload(3, 8));
  tree->readData(stream);
  expectVoxel(tree.get());
}

TEST(SemanticOctreeClient, file_is_read_through_the_factory) {
  std::stringstream stream("# Octomap OcTree file\nid SemanticOcTree\nsize 17\nres 0.2\ndata\n" +
                           makePayload(3, 8));
  std::unique_ptr<octomap::AbstractOcTree> tree(octomap::AbstractOcTree::read(stream));
  ASSERT_NE(tree, nullptr);
  expectVoxel(tree.get());
}

TEST(SemanticOctreeClient, brings_neither_ros_nor_opencv_nor_the_rest_of_the_package) {
  std::ifstream maps("/proc/self/maps");
  const std::string text((std::istreambuf_iterator<char>(maps)), std::istreambuf_iterator<char>());
  EXPECT_NE(text.find("libcore_semantic_octree"), std::string::npos);
  for (const char* library : {"libroscpp", "librosconsole", "libopencv", "libcore_perception"}) {
    EXPECT_EQ(text.find(library), std::string::npos) << library;
  }
}

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
