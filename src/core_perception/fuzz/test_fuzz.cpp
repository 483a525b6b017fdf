// SPDX-License-Identifier: BSD-3-Clause
/// Replay of the first inputs and of CORE_FUZZ_CASES changed ones by a target; CORE_SEED sets
/// which.
#include <gtest/gtest.h>

#include <cstdlib>
#include <random>

#include "targets.h"

namespace core_perception {
namespace fuzz {
namespace {

uint32_t readNumber(const char* name, uint32_t otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : static_cast<uint32_t>(std::strtoul(text, nullptr, 10));
}

/// One to eight bytes set, put in or taken out.
Input change(Input input, std::mt19937* random) {
  static const uint8_t kSpecial[] = {0x00, 0x01, 0x7F, 0x80, 0xFF};
  const auto below = [random](size_t n) { return (*random)() % n; };
  for (size_t n = 1 + below(8); n > 0; --n) {
    const size_t i = below(input.size() + 1);
    const auto byte = static_cast<uint8_t>(below(2) == 0 ? (*random)() : kSpecial[below(5)]);
    const size_t kind = below(6);
    const auto at = input.begin() + static_cast<std::ptrdiff_t>(i);
    if (kind == 0 || i == input.size()) {
      input.insert(at, byte);
    } else if (kind == 1) {
      input.erase(at);
    } else {
      *at = byte;
    }
  }
  return input;
}

std::string toHex(const Input& input) {
  static const char kDigits[] = "0123456789abcdef";
  std::string text;
  for (const uint8_t byte : input) {
    text += kDigits[byte >> 4];
    text += kDigits[byte & 15];
  }
  return text;
}

/// @returns false, with the input in words, when something came out that no frame may cause.
bool holds(const NamedTarget& target, const Input& input, Tally* tally) {
  try {
    target.run(input.data(), input.size(), tally);
    return true;
  } catch (const std::exception& error) {
    ADD_FAILURE() << target.name << ": " << error.what() << "; input " << toHex(input);
    return false;
  }
}

class FuzzTest : public ::testing::TestWithParam<int> {};

TEST_P(FuzzTest, no_input_crashes_the_chain_or_breaks_a_promise) {
  const NamedTarget& target = targets()[static_cast<size_t>(GetParam())];
  std::mt19937 random(readNumber("CORE_SEED", 0));
  Tally tally;
  for (const Input& seed : target.seeds) ASSERT_TRUE(holds(target, seed, &tally));
  for (uint32_t n = readNumber("CORE_FUZZ_CASES", 1500); n > 0; --n) {
    const Input input = change(target.seeds[random() % target.seeds.size()], &random);
    ASSERT_TRUE(holds(target, input, &tally));
  }
  // The judge had something to judge, of both kinds.
  int refused = 0;
  for (const auto& reason : tally.refused) refused += reason.second;
  const int all = tally.accepted + refused;
  EXPECT_GT(tally.accepted, all / 10);
  EXPECT_GT(refused, all / 20);
}

INSTANTIATE_TEST_SUITE_P(Targets, FuzzTest, ::testing::Values(0, 1, 2));

TEST(Fuzz, every_reason_to_refuse_a_frame_occurs) {
  const NamedTarget& target = targets()[0];
  std::mt19937 random(2);
  Tally tally;
  for (int n = 0; n < 600; ++n) {
    const Input input = change(target.seeds[random() % target.seeds.size()], &random);
    ASSERT_TRUE(holds(target, input, &tally));
  }
  for (const char* reason : {"image_size", "image_encoding", "frame_id", "camera_invalid",
                             "distorted", "labels_invalid", "stamp_invalid", "pose_invalid"})
    EXPECT_GT(tally.refused[reason], 0) << reason;
}

TEST(Fuzz, the_empty_input_is_a_frame_that_is_added) {
  Tally tally;
  runFrames(nullptr, 0, &tally);
  EXPECT_EQ(tally.accepted, 1);
  EXPECT_TRUE(tally.refused.empty());
}

}  // namespace
}  // namespace fuzz
}  // namespace core_perception

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
