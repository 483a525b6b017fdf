// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <octomap/ColorOcTree.h>
#include <octomap/OcTree.h>

#include <map>
#include <memory>
#include <random>
#include <sstream>
#include <tuple>
#include <utility>

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

using Reference = std::map<std::tuple<unsigned, unsigned, unsigned>, std::pair<uint32_t, uint32_t>>;

/// Every voxel the tree stands for, pruned cubes taken apart.
Reference listVoxels(const SemanticOcTree& tree) {
  Reference voxels;
  forEachLeaf(takeSnapshot(tree), [&](const SnapshotLeaf& leaf) {
    for (int x = 0; x < leaf.edge(); ++x)
      for (int y = 0; y < leaf.edge(); ++y)
        for (int z = 0; z < leaf.edge(); ++z)
          voxels[std::make_tuple(leaf.lowest[0] + x, leaf.lowest[1] + y, leaf.lowest[2] + z)] =
              std::make_pair(leaf.counts.n_safe, leaf.counts.n_unsafe);
  });
  return voxels;
}

TEST(SemanticOcTree, random_touch_erase_prune_and_expand_equal_a_plain_map) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    std::mt19937 random(seed);
    SemanticOcTree tree(0.2);
    Reference reference;
    size_t n_pruned = 0;
    for (int i = 0; i < 6000; ++i) {
      const auto key =
          std::make_tuple(32766 + random() % 6, 32764 + random() % 6, 32768 + random() % 6);
      const auto octomap_key = makeKey(std::get<0>(key), std::get<1>(key), std::get<2>(key));
      const unsigned action = random() % 100;
      if (action < 78) {
        const std::pair<uint32_t, uint32_t> counts(1, 1 + random() % 20 / 19);  // mostly alike
        tree.touch(octomap_key)->setCounts(counts.first, counts.second);
        reference[key] = counts;
      } else if (action < 84) {
        tree.erase(octomap_key);
        reference.erase(key);
      } else if (action < 98) {
        const SemanticOcTreeNode* node = tree.find(octomap_key);
        ASSERT_EQ(node != nullptr, reference.count(key) == 1) << "seed " << seed << " step " << i;
        if (node != nullptr) {
          ASSERT_EQ(std::make_pair(node->n_safe(), node->n_unsafe()), reference[key]);
        }
      } else if (action == 98) {
        const size_t before = tree.size();
        tree.prune();
        n_pruned += before - tree.size();
      } else {
        tree.expand();
      }
    }
    EXPECT_GT(n_pruned, 100u);
    ASSERT_EQ(listVoxels(tree), reference) << "seed " << seed;
    tree.prune();
    ASSERT_EQ(listVoxels(tree), reference) << "seed " << seed;
    EXPECT_EQ(tree.size(), tree.calcNumNodes());
    tree.expand();
    ASSERT_EQ(listVoxels(tree), reference) << "seed " << seed;
  }
}

TEST(SemanticOcTree, nodes_of_one_value_and_other_counts_are_not_pruned) {
  SemanticOcTree tree(0.2);
  for (unsigned i = 0; i < 8; ++i)  // all of value 0
    tree.touch(makeKey(8 + i % 2, 8 + i / 2 % 2, 8 + i / 4))->setCounts(2 + i % 2, 2 + i % 2);
  const Reference before = listVoxels(tree);
  tree.prune();
  EXPECT_EQ(tree.getNumLeafNodes(), 8u);
  EXPECT_EQ(listVoxels(tree), before);
}

TEST(SemanticOcTree, inner_nodes_hold_no_counts_after_expanding) {
  SemanticOcTree tree(0.2);
  for (unsigned i = 0; i < 8; ++i)
    tree.touch(makeKey(8 + i % 2, 8 + i / 2 % 2, 8 + i / 4))->setCounts(2, 3);
  tree.prune();
  EXPECT_EQ(tree.getNumLeafNodes(), 1u);
  tree.expand();
  for (auto it = tree.begin_tree(); it != tree.end_tree(); ++it) {
    EXPECT_EQ(it->n_unsafe(), it.isLeaf() ? 3u : 0u);
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
      readAsClient("SemanticOcTree", serialise(WireFormat::kSemantic, tree), false);
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
      readAsClient(idOf(WireFormat::kFull), serialise(WireFormat::kFull, tree), false);
  const auto binary =
      readAsClient(idOf(WireFormat::kBinary), serialise(WireFormat::kBinary, tree), true);
  const auto color =
      readAsClient(idOf(WireFormat::kColor), serialise(WireFormat::kColor, tree), false);
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

std::string toText(const std::vector<int8_t>& bytes) {
  return std::string(bytes.begin(), bytes.end());
}

TEST(OctomapWire, bytes_equal_those_of_octomaps_own_writers) {
  SemanticOcTree tree(0.2);
  fillRandomly(8, &tree);
  for (const bool pruned : {false, true}) {
    if (pruned) tree.prune();
    const TreeSnapshot snapshot = takeSnapshot(tree);
    tree.updateInnerOccupancy();
    std::ostringstream semantic, binary, full, file, binary_file;
    tree.writeData(semantic);
    tree.writeBinaryData(binary);
    EXPECT_EQ(toText(serialise(WireFormat::kSemantic, snapshot)), semantic.str());
    EXPECT_EQ(toText(serialise(WireFormat::kBinary, snapshot)), binary.str());
    octomap::OcTree plain(0.2);
    std::stringstream in(toText(serialise(WireFormat::kFull, snapshot)));
    plain.readData(in);
    plain.writeData(full);
    EXPECT_EQ(toText(serialise(WireFormat::kFull, snapshot)), full.str());
    std::stringstream ot(formatFile(WireFormat::kSemantic, snapshot));
    const std::unique_ptr<octomap::AbstractOcTree> read(octomap::AbstractOcTree::read(ot));
    ASSERT_NE(read, nullptr);
    EXPECT_TRUE(dynamic_cast<SemanticOcTree&>(*read) == tree);
    std::stringstream bt(formatFile(WireFormat::kBinary, snapshot));
    octomap::OcTree from_bt(0.1);
    ASSERT_TRUE(from_bt.readBinary(bt));
    EXPECT_EQ(from_bt.getResolution(), 0.2);
    EXPECT_EQ(from_bt.getNumLeafNodes(), tree.getNumLeafNodes());
  }
}

TEST(TreeSnapshot, snapshots_taken_in_turn_equal_whole_ones) {
  for (unsigned seed = 0; seed < 5; ++seed) {
    std::mt19937 random(seed);
    SemanticOcTree tree(0.2);
    SnapshotTaker taker;
    size_t n_compared = 0;
    for (int i = 0; i < 8000; ++i) {
      const auto key =
          makeKey(32740 + random() % 60, 32740 + random() % 60 / 20 * 20, 32766 + random() % 4);
      const unsigned action = random() % 1000;
      if (action < 600) {
        tree.touch(key)->setCounts(random() % 3, random() % 3);
      } else if (action < 960) {
        tree.erase(key);
      } else if (action < 963) {
        tree.prune();
      } else if (action < 965) {
        tree.expand();
      } else if (action < 966) {
        tree.clear();
      } else if (action < 990) {
        ASSERT_EQ(taker.take(&tree).nodes, takeSnapshot(tree).nodes) << "seed " << seed << " " << i;
        ++n_compared;
      }
    }
    EXPECT_GT(n_compared, 100u);
  }
}

TEST(TreeSnapshot, only_blocks_that_changed_are_named) {
  SemanticOcTree tree(0.2);
  tree.touch(makeKey(100, 100, 100));
  EXPECT_TRUE(tree.takeChanges().everywhere);
  tree.touch(makeKey(100, 100, 101));
  tree.touch(makeKey(400, 100, 100));
  tree.erase(makeKey(100, 100, 100));
  const SemanticOcTree::Changes changes = tree.takeChanges();
  EXPECT_FALSE(changes.everywhere);
  EXPECT_EQ(changes.blocks.size(), 2u);
  EXPECT_EQ(changes.blocks.count(SemanticOcTree::blockOf(makeKey(111, 111, 111))), 1u);
  EXPECT_TRUE(tree.takeChanges().blocks.empty());
}

TEST(OctomapWire, leaves_of_a_snapshot_are_those_of_the_tree) {
  SemanticOcTree tree(0.2);
  fillRandomly(9, &tree);
  size_t n = 0;
  forEachLeaf(takeSnapshot(tree), [&](const SnapshotLeaf& leaf) {
    ++n;
    EXPECT_EQ(leaf.depth, 16u);
    const SemanticOcTreeNode* node = tree.find(leaf.lowest);
    ASSERT_NE(node, nullptr);
    EXPECT_EQ(leaf.counts, (Counts{node->n_safe(), node->n_unsafe()}));
  });
  EXPECT_EQ(n, tree.getNumLeafNodes());
}

TEST(OctomapWire, empty_tree_has_no_bytes) {
  SemanticOcTree tree(0.2);
  for (const WireFormat f :
       {WireFormat::kFull, WireFormat::kBinary, WireFormat::kColor, WireFormat::kSemantic}) {
    EXPECT_TRUE(serialise(f, tree).empty());
  }
}

}  // namespace
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
