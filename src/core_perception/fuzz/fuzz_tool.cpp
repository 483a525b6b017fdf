// SPDX-License-Identifier: BSD-3-Clause
/// fuzz_tool corpus DIR: writes the first inputs of every target to DIR/TARGET/.
/// fuzz_tool replay TARGET FILE...: runs inputs again, such as those libFuzzer kept.
#include <cstdio>
#include <fstream>
#include <iterator>

#include "targets.h"

namespace {

using core_perception::fuzz::Input;
using core_perception::fuzz::NamedTarget;

int writeCorpus(const std::string& folder) {
  for (const NamedTarget& target : core_perception::fuzz::targets()) {
    for (size_t i = 0; i < target.seeds.size(); ++i) {
      const std::string path = folder + "/" + target.name + "/seed_" + std::to_string(i);
      std::ofstream file(path, std::ios::binary);
      const Input& seed = target.seeds[i];
      file.write(reinterpret_cast<const char*>(seed.data()),
                 static_cast<std::streamsize>(seed.size()));
      if (!file) {
        std::fprintf(stderr, "fuzz_tool: cannot write %s; the folder must exist\n", path.c_str());
        return 2;
      }
    }
  }
  return 0;
}

int replay(const std::string& name, const char* const* begin, const char* const* end) {
  const NamedTarget* target = core_perception::fuzz::findTarget(name);
  if (target == nullptr) {
    std::fprintf(stderr, "fuzz_tool: target: got %s, allowed frames, constraints, wire\n",
                 name.c_str());
    return 2;
  }
  for (; begin != end; ++begin) {
    std::ifstream file(*begin, std::ios::binary);
    const Input input{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
    core_perception::fuzz::Tally tally;
    target->run(input.data(), input.size(), &tally);
    std::printf("%s: %d frames added\n", *begin, tally.accepted);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string command = argc > 1 ? argv[1] : "";
  if (command == "corpus" && argc == 3) return writeCorpus(argv[2]);
  if (command == "replay" && argc > 3) return replay(argv[2], argv + 3, argv + argc);
  std::fprintf(stderr, "usage: fuzz_tool corpus DIR | replay TARGET FILE...\n");
  return 2;
}
