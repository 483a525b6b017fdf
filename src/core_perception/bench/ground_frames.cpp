// SPDX-License-Identifier: BSD-3-Clause
// ground_frames PARAMS RECORDING EVERY OUTPUT
//
// Runs SemanticMap over a recording (core_frames 1) and writes what it decided after every EVERY-th
// frame and after the last one. Holds one frame at a time. PARAMS as in param_text.h.
//
// OUTPUT, format "core_grids 1": a text header of one statement a line, then records in binary,
// little-endian, up to the end of the file:
//
//     core_grids 1
//     resolution_m X
//     unknown_is_unsafe 0|1
//     end
//     record: int32 frame (counted from 0), float64 stamp_s,
//             int32 origin_x, int32 origin_y: indices of cell (0, 0) in the fixed frame; its corner
//             is at origin * resolution_m,
//             int32 width, int32 height, then row-major (index = y * width + x) for all n cells
//             uint8[n] state (0 safe, 1 unsafe, 2 unknown), float32[n] h [m],
//             uint16[n] cause (index, 65535 for none), then int32 count of causes, and for each
//             int32 bytes, then as many bytes of text: RULE tab CLASS tab INSTANCE

#include <cstdio>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <limits>
#include <string>

#include "core_perception/semantic_map.h"
#include "frame_file.h"
#include "param_text.h"
#include "program.h"

namespace core_perception {
namespace bench {
namespace {

template <typename T>
void writeNumber(T value, std::ostream* out) {
  out->write(reinterpret_cast<const char*>(&value), sizeof(T));
}

template <typename T>
void writeArray(const std::vector<T>& values, std::ostream* out) {
  out->write(reinterpret_cast<const char*>(values.data()),
             static_cast<std::streamsize>(values.size() * sizeof(T)));
}

void writeHeader(const SemanticMapParams& params, std::ostream* out) {
  out->precision(std::numeric_limits<double>::max_digits10);
  *out << "core_grids 1\nresolution_m " << params.resolution_m << "\nunknown_is_unsafe "
       << params.unknown_is_unsafe << "\nend\n";
}

void writeGrid(int index, double stamp_s, const SafetyGrid& grid, std::ostream* out) {
  writeNumber<int32_t>(index, out);
  writeNumber<double>(stamp_s, out);
  writeNumber<int32_t>(grid.frame.origin.x, out);
  writeNumber<int32_t>(grid.frame.origin.y, out);
  writeNumber<int32_t>(grid.frame.width, out);
  writeNumber<int32_t>(grid.frame.height, out);
  writeArray(grid.state, out);
  writeArray(grid.h_m, out);
  writeArray(grid.cause, out);
  writeNumber<int32_t>(static_cast<int32_t>(grid.causes.size()), out);
  for (const Cause& cause : grid.causes) {
    const std::string text =
        cause.rule + '\t' + cause.class_name + '\t' + std::to_string(cause.instance_id);
    writeNumber<int32_t>(static_cast<int32_t>(text.size()), out);
    *out << text;
  }
}

int run(int argc, char** argv) {
  if (argc != 5) throw std::runtime_error("see the top of ground_frames.cpp");
  const SemanticMapParams params = readParams(argv[1]);
  FrameFile file(argv[2]);
  const int every = std::atoi(argv[3]);
  if (every < 1) throw std::runtime_error("EVERY: allowed >= 1");
  std::ofstream out(argv[4], std::ios::binary);
  writeHeader(params, &out);
  SemanticMap map(params);
  const Constraints constraints = file.constraints();
  const int n = file.header().n_frames;
  Frame frame;
  for (int i = 0; file.next(&frame); ++i) {
    const SafetyGrid& grid = map.update(frame, constraints);
    if ((i + 1) % every == 0 || i + 1 == n) writeGrid(i, frame.stamp_s, grid, &out);
  }
  if (!out.flush()) throw std::runtime_error(std::string(argv[4]) + ": cannot be written");
  return 0;
}

}  // namespace
}  // namespace bench
}  // namespace core_perception

int main(int argc, char** argv) {
  return core_perception::bench::runProgram("ground_frames", core_perception::bench::run, argc,
                                            argv);
}
