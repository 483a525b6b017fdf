// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <octomap/ColorOcTree.h>
#include <octomap/OcTree.h>

#include <map>
#include <memory>
#include <random>
#include <sstream>

#include "core_perception/octomap_wire.h"
#include "core_perception/semantic_octree.h"

namespace core_perception {
namespace {

octomap::OcTreeKey makeKey(unsigned x, unsigned y, unsigned z) {
  return octomap::OcTreeKey(static_cast<uint16_t>(x), static_cast<uint16_t>(y),
                            static_cast<uint16_t>(z));
}

void fillRandomly(unsigned seed, SemanticOcTree* tree) {
  std::mt19937 random(seed);
  for (int i = 0; i < 2000; ++i) {
    SemanticOcTreeNode* node =
        tree->touch(makeKey(32700 + random() % 40, 32700 + random() % 40, 32760 + random() % 16));
    node->setCounts(random() % 4, random() % 4 + 1);
  }
}

/// What a client does with a message: the factory by id, then the bytes.
std::unique_ptr<octomap::AbstractOcTree> readAsClient(const std::string& id,
                                                      const std::vector<int8_t>& data,
                                                      bool binary) {
  std::unique_ptr<octomap::AbstractOcTree> tree(octomap::AbstractOcTree::createTree(id, 0.2));
  if (tree == nullptr) return tree;
  std::stringstream stream(std::string(data.begin(), data.end()));
  if (binary) {
    dynamic_cast<octomap::OcTree&>(*tree).readBinaryData(stream);
  } else {
    tree->readData(stream);
  }
  EXPECT_EQ(stream.peek(), EOF) << "bytes left over";
  return tree;
}

TEST(SemanticOcTree, touch_finds_what_touch_made) {
  SemanticOcTree tree(0.2);
  std::mt19937 random(5);
  std::map<std::tuple<unsigned, unsigned, unsigned>, uint32_t> expected;
  for (int i = 0; i < 5000; ++i) {
    const auto key =
        std::make_tuple(random() % 65536, 32768 + random() % 8, random() % 65536 / 8192 * 8192);
    SemanticOcTreeNode* node =
        tree.touch(makeKey(std::get<0>(key), std::get<1>(key), std::get<2>(key)));
    EXPECT_EQ(node->n_safe(), expected[key]);
    node->setCounts(++expected[key], 0);
  }
  EXPECT_EQ(tree.getNumLeafNodes(), expected.size());
  for (const auto& entry : expected) {
    const auto& key = entry.first;
    const SemanticOcTreeNode* node =
        tree.find(makeKey(std::get<0>(key), std::get<1>(key), std::get<2>(key)));
    ASSERT_NE(node, nullptr);
    EXPECT_EQ(node->n_safe(), entry.second);
  }
}

TEST(SemanticOcTree, erase_removes_the_voxel_and_empty_inner_nodes) {
  SemanticOcTree tree(0.2);
  tree.touch(makeKey(1, 2, 3))->setCounts(1, 0);
  tree.touch(makeKey(1, 2, 4))->setCounts(0, 1);
  tree.erase(makeKey(1, 2, 3));
  tree.erase(makeKey(9, 9, 9));
  EXPECT_EQ(tree.find(makeKey(1, 2, 3)), nullptr);
  EXPECT_EQ(tree.getNumLeafNodes(), 1u);
  EXPECT_EQ(tree.size(), tree.calcNumNodes());
  tree.erase(makeKey(1, 2, 4));
  EXPECT_EQ(tree.size(), 0u);
  EXPECT_EQ(tree.getRoot(), nullptr);
}

TEST(SemanticOcTree, prune_and_expand_lose_no_vote) {
  SemanticOcTree tree(0.2), reference(0.2);
  for (SemanticOcTree* t : {&tree, &reference}) {
    for (unsigned i = 0; i < 64; ++i) {
      // The first eight share counts and are pruned; the others share the value but not the counts.
      t->touch(makeKey(i % 4, i / 4 % 4, i / 16))
          ->setCounts(i < 32 && i % 4 < 2 && i / 4 % 4 < 2 ? 3 : i, 1);
    }
  }
  tree.prune();
  EXPECT_LT(tree.getNumLeafNodes(), reference.getNumLeafNodes());
  tree.touch(makeKey(1, 1, 1))->setCounts(7, 7);
  reference.touch(makeKey(1, 1, 1))->setCounts(7, 7);
  tree.expand();
  for (unsigned i = 0; i < 64; ++i) {
    const auto key = makeKey(i % 4, i / 4 % 4, i / 16);
    ASSERT_NE(tree.find(key), nullptr);
    EXPECT_TRUE(*tree.find(key) == *reference.find(key)) << i;
  }
}

TEST(SemanticOcTree, value_is_occupied_exactly_when_no_more_safe_than_unsafe_votes) {
  SemanticOcTreeNode node;
  for (uint32_t s = 0; s < 5; ++s) {
    for (uint32_t u = 0; u < 5; ++u) {
      node.setCounts(s, u);
      EXPECT_EQ(node.getValue() >= 0.0f, u >= s);
      EXPECT_FLOAT_EQ(node.getValue(), static_cast<float>(std::log((u + 0.5) / (s + 0.5))));
    }
  }
}

TEST(SemanticOcTree, file_and_message_round_trip_keep_every_count) {
  SemanticOcTree tree(0.2);
  fillRandomly(6, &tree);
  tree.updateInnerOccupancy();
  std::stringstream file;
  ASSERT_TRUE(tree.write(file));
  const std::unique_ptr<octomap::AbstractOcTree> read(octomap::AbstractOcTree::read(file));
  ASSERT_NE(read, nullptr);
  EXPECT_TRUE(dynamic_cast<SemanticOcTree&>(*read) == tree);
  const auto message =
      readAsClient("SemanticOcTree", serialise(WireFormat::kSemantic, &tree), false);
  EXPECT_TRUE(dynamic_cast<SemanticOcTree&>(*message) == tree);
}

TEST(SemanticOcTree, unknown_id_is_refused_and_the_colour_class_stays_what_it_was) {
  EXPECT_EQ(octomap::AbstractOcTree::createTree("SemanticOctree", 0.2), nullptr);
  std::unique_ptr<octomap::AbstractOcTree> color(
      octomap::AbstractOcTree::createTree("ColorOcTree", 0.2));
  EXPECT_NE(dynamic_cast<octomap::ColorOcTree*>(color.get()), nullptr);
}

TEST(OctomapWire, every_format_is_read_by_the_class_of_its_id) {
  SemanticOcTree tree(0.2);
  fillRandomly(7, &tree);
  const auto full =
      readAsClient(idOf(WireFormat::kFull), serialise(WireFormat::kFull, &tree), false);
  const auto binary =
      readAsClient(idOf(WireFormat::kBinary), serialise(WireFormat::kBinary, &tree), true);
  const auto color =
      readAsClient(idOf(WireFormat::kColor), serialise(WireFormat::kColor, &tree), false);
  auto& full_tree = dynamic_cast<octomap::OcTree&>(*full);
  auto& binary_tree = dynamic_cast<octomap::OcTree&>(*binary);
  auto& color_tree = dynamic_cast<octomap::ColorOcTree&>(*color);
  size_t n = 0;
  for (auto it = tree.begin_leafs(); it != tree.end_leafs(); ++it, ++n) {
    const bool unsafe = it->n_unsafe() >= it->n_safe();
    EXPECT_EQ(full_tree.search(it.getKey())->getValue(), it->getValue());
    EXPECT_EQ(binary_tree.isNodeOccupied(binary_tree.search(it.getKey())), unsafe);
    const octomap::ColorOcTreeNode* node = color_tree.search(it.getKey());
    EXPECT_TRUE(color_tree.isNodeOccupied(node));
    EXPECT_EQ(node->getColor().r > node->getColor().g, unsafe);
  }
  EXPECT_EQ(full_tree.getNumLeafNodes(), n);
  EXPECT_EQ(color_tree.getNumLeafNodes(), n);
}

TEST(OctomapWire, empty_tree_has_no_bytes) {
  SemanticOcTree tree(0.2);
  for (const WireFormat f :
       {WireFormat::kFull, WireFormat::kBinary, WireFormat::kColor, WireFormat::kSemantic}) {
    EXPECT_TRUE(serialise(f, &tree).empty());
  }
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
