// SPDX-License-Identifier: BSD-3-Clause
// bench_grounding PARAMS RECORDING PASSES EVERY [reference]
//
// Runs SemanticMap over a recording PASSES times, each time from an empty map, and beside it, on
// the same frames, a plain OpenCV pipeline (first pass) and OctoMap's insertPointCloud (every
// EVERY-th frame). Prints lines for test/bench/grounding.py:
//
//     series NAME PASS VALUE...     per frame; NAME ends with its unit
//     value NAME VALUE
//
// With `reference` the decisions are compared with those of ReferenceMap, frame by frame.

#include <Eigen/StdVector>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <exception>
#include <string>
#include <vector>

#include "core_perception/semantic_map.h"
#include "core_perception/stage_clock.h"
#include "frame_file.h"
#include "octomap_insertion.h"
#include "param_text.h"
#include "plain_pipeline.h"
#include "program.h"
#include "reference_map.h"

namespace core_perception {
namespace bench {
namespace {

const char* const kStageNames[kStages] = {"prepare", "operators", "points",  "voxels", "clearing",
                                          "objects", "instances", "regions", "grid"};

double readClock_ms(clockid_t clock) {
  timespec now;
  clock_gettime(clock, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

double readCpu_ms() { return readClock_ms(CLOCK_PROCESS_CPUTIME_ID); }

void printSeries(const std::string& name, int pass, const std::vector<double>& values) {
  std::printf("series %s %d", name.c_str(), pass);
  for (const double value : values) std::printf(" %.6f", value);
  std::printf("\n");
  std::fflush(stdout);
}

void printValue(const std::string& name, uint64_t value) {
  std::printf("value %s %llu\n", name.c_str(), static_cast<unsigned long long>(value));
}

/// CPU time of every stage of one frame.
class StageTimer : public StageClock {
 public:
  void start() {
    for (double& ms : ms_) ms = 0.0;
    last_ms_ = readCpu_ms();
  }
  void mark(Stage stage) override {
    const double now_ms = readCpu_ms();
    ms_[static_cast<int>(stage)] += now_ms - last_ms_;
    last_ms_ = now_ms;
  }
  double ms(int stage) const { return ms_[stage]; }

 private:
  double ms_[kStages] = {};
  double last_ms_ = 0.0;
};

struct Recording {
  // A plain vector would put Eigen's matrices where -march=native may not load them (C++14).
  std::vector<Frame, Eigen::aligned_allocator<Frame>> frames;
  Constraints constraints;
};

Recording load(const std::string& path) {
  FrameFile file(path);
  Recording recording;
  recording.constraints = file.constraints();
  Frame frame;
  while (file.next(&frame)) recording.frames.push_back(frame);
  return recording;
}

/// The frame as a message that has just come brings it: its images lie in the cache. OctoMap's
/// cloud too is made just before the clock starts.
Frame receive(const Frame& frame) {
  Frame fresh = frame;
  fresh.depth = frame.depth.clone();
  fresh.labels = frame.labels.clone();
  return fresh;
}

void measureMap(const SemanticMapParams& params, const Recording& recording, int pass) {
  SemanticMap map(params);
  std::vector<double> cpu_ms, wall_ms;
  for (const Frame& recorded : recording.frames) {
    const Frame frame = receive(recorded);
    const double wall = readClock_ms(CLOCK_MONOTONIC), cpu = readCpu_ms();
    map.update(frame, recording.constraints);
    cpu_ms.push_back(readCpu_ms() - cpu);
    wall_ms.push_back(readClock_ms(CLOCK_MONOTONIC) - wall);
  }
  printSeries("whole_cpu_ms", pass, cpu_ms);
  printSeries("whole_wall_ms", pass, wall_ms);
}

/// A pass of its own, because reading the clock between the stages costs time too.
void measureStages(const SemanticMapParams& params, const Recording& recording, int pass) {
  SemanticMap map(params);
  StageTimer timer;
  map.observeStages(&timer);
  std::vector<std::vector<double>> stages_ms(kStages);
  for (const Frame& recorded : recording.frames) {
    const Frame frame = receive(recorded);
    timer.start();
    map.update(frame, recording.constraints);
    for (int i = 0; i < kStages; ++i) stages_ms[i].push_back(timer.ms(i));
  }
  for (int i = 0; i < kStages; ++i)
    printSeries(std::string("stage_") + kStageNames[i] + "_cpu_ms", pass, stages_ms[i]);
}

void measurePlain(const SemanticMapParams& params, const Recording& recording) {
  PlainPipeline pipeline(params);
  std::vector<double> cpu_ms;
  for (const Frame& recorded : recording.frames) {
    const Frame frame = receive(recorded);
    const double cpu = readCpu_ms();
    pipeline.update(frame, recording.constraints.predicates);
    cpu_ms.push_back(readCpu_ms() - cpu);
  }
  printSeries("opencv_cpu_ms", 0, cpu_ms);
}

void measureInsertion(const SemanticMapParams& params, const Recording& recording, int every,
                      bool discretize) {
  octomap::OcTree tree(params.resolution_m);
  std::vector<double> cpu_ms;
  for (size_t i = 0; i < recording.frames.size(); i += every) {
    const Frame& frame = recording.frames[i];
    const octomap::Pointcloud cloud = makeCloud(frame, params.range);
    const double cpu = readCpu_ms();
    insertCloud(cloud, frame, discretize, &tree);
    cpu_ms.push_back(readCpu_ms() - cpu);
  }
  printSeries(discretize ? "insert_discretized_cpu_ms" : "insert_point_cloud_cpu_ms", 0, cpu_ms);
}

void countPoints(const SemanticMapParams& params, const Recording& recording) {
  std::vector<double> points;
  for (const Frame& frame : recording.frames)
    points.push_back(static_cast<double>(makeCloud(frame, params.range).size()));
  printSeries("points", 0, points);
}

void compareWithReference(const SemanticMapParams& params, const Recording& recording) {
  SemanticMap map(params);
  ReferenceMap reference(params);
  uint64_t compared = 0, different = 0;
  for (const Frame& frame : recording.frames) {
    const SafetyGrid& grid = map.update(frame, recording.constraints);
    reference.update(frame, recording.constraints.predicates);
    different += reference.countDifferent(grid, &compared);
  }
  const SemanticOcTree& tree = map.votes().tree();
  printValue("decisions_compared", compared);
  printValue("decisions_different", different);
  printValue("observations", reference.observations());
  printValue("observations_different", reference.countDifferent(tree));
  printValue("leaf_counts", sumLeafCounts(tree));
}

int run(int argc, char** argv) {
  if (argc < 5 || argc > 6) throw std::runtime_error("see the top of bench_grounding.cpp");
  const SemanticMapParams params = readParams(argv[1]);
  const Recording recording = load(argv[2]);
  const int passes = std::atoi(argv[3]), every = std::atoi(argv[4]);
  if (passes < 1 || every < 1) throw std::runtime_error("PASSES and EVERY: allowed >= 1");
  if (argc == 6) compareWithReference(params, recording);
  countPoints(params, recording);
  for (int pass = 0; pass < passes; ++pass) {
    measureMap(params, recording, pass);
    measureStages(params, recording, pass);
    // Between the passes, so that all of them meet the same company on the machine.
    if (pass == 0) measurePlain(params, recording);
    if (pass == 0) measureInsertion(params, recording, every, false);
    if (pass == 1 || passes == 1) measureInsertion(params, recording, every, true);
  }
  return 0;
}

}  // namespace
}  // namespace bench
}  // namespace core_perception

int main(int argc, char** argv) {
  return core_perception::bench::runProgram("bench_grounding", core_perception::bench::run, argc,
                                            argv);
}
