// SPDX-License-Identifier: BSD-3-Clause
#include "frame_file.h"

#include <cmath>
#include <cstring>
#include <set>
#include <sstream>
#include <stdexcept>

namespace core_perception {
namespace bench {
namespace {

constexpr char kMagic[] = "core_frames 1";
constexpr size_t kPoseBytes = (1 + 16 + 2) * sizeof(double);

size_t countPixels(const Camera& camera) {
  return static_cast<size_t>(camera.width_px) * camera.height_px;
}

bool isWithin(int value, int low, int high) { return value >= low && value <= high; }

bool readSize(std::istream* words, Camera* camera) {
  constexpr int kLargest_px = 16384;
  return (*words >> camera->width_px >> camera->height_px) &&
         isWithin(camera->width_px, 1, kLargest_px) && isWithin(camera->height_px, 1, kLargest_px);
}

bool readCamera(std::istream* words, Camera* camera) {
  return (*words >> camera->fx_px >> camera->fy_px >> camera->cx_px >> camera->cy_px) &&
         camera->fx_px > 0.0 && camera->fy_px > 0.0;
}

bool readClass(std::istream* words, std::vector<LabelClass>* classes) {
  int id = 0;
  std::string name;
  if (!(*words >> id >> name) || !isWithin(id, 1, 65535)) return false;
  classes->push_back({static_cast<uint16_t>(id), name});
  return true;
}

bool readPredicate(std::istream* words, std::vector<Predicate>* predicates) {
  int spatial_operator = -1, verdict = -1, severity = -1;
  Predicate p;
  *words >> spatial_operator >> p.class_name >> verdict >> severity >> p.radius_m;
  const bool ok = *words && isWithin(spatial_operator, 0, 3) && isWithin(verdict, 0, 1) &&
                  isWithin(severity, 0, 1) && p.radius_m >= 0.0;
  if (!ok) return false;
  p.spatial_operator = static_cast<SpatialOperator>(spatial_operator);
  p.verdict = static_cast<Verdict>(verdict);
  p.severity = static_cast<Severity>(severity);
  predicates->push_back(p);
  return true;
}

bool readCount(std::istream* words, int* count) { return (*words >> *count) && *count >= 0; }

}  // namespace

FrameFile::FrameFile(const std::string& path)
    : path_(path), file_(path, std::ios::binary), class_of_label_(65536, nullptr) {
  if (!file_) fail("recording", "cannot be opened", "a file of format core_frames 1");
  readHeader(&file_);
  first_frame_ = file_.tellg();
  buffer_.resize(kPoseBytes + 4 * countPixels(header_.camera));
  if (isFile()) checkSize();
  for (const LabelClass& label : header_.classes) class_of_label_[label.id] = &label;
  std::set<std::string> names;
  for (const LabelClass& label : header_.classes) names.insert(label.class_name);
  class_names_.assign(names.begin(), names.end());
}

void FrameFile::checkSize() {
  file_.seekg(0, std::ios::end);
  const std::streamoff due =
      first_frame_ + static_cast<std::streamoff>(buffer_.size()) * header_.n_frames;
  if (file_.tellg() != due)
    fail("frames", "the file has another size", std::to_string(due) + " bytes");
  rewind();
}

Constraints FrameFile::constraints() const {
  Constraints constraints;
  constraints.image_stamp_s = 1e-9;  // before every frame, and in force
  constraints.predicates = header_.predicates;
  return constraints;
}

void FrameFile::rewind() {
  if (!isFile()) fail("recording", "a pipe cannot be read again", "a file");
  file_.clear();
  file_.seekg(first_frame_);
  n_read_ = 0;
}

bool FrameFile::next(Frame* frame) {
  if (n_read_ == header_.n_frames) return false;
  if (!file_.read(buffer_.data(), static_cast<std::streamsize>(buffer_.size())))
    fail("frame " + std::to_string(n_read_), "cannot be read", "a whole frame");
  ++n_read_;
  double numbers[19];
  std::memcpy(numbers, buffer_.data(), kPoseBytes);
  frame->stamp_s = numbers[0];
  frame->camera = header_.camera;
  frame->T_map_camera.matrix() =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(numbers + 1);
  frame->p_map_base = {numbers[17], numbers[18]};
  const Camera& camera = header_.camera;
  const size_t image_bytes = 2 * countPixels(camera);
  // New images every time: a caller may keep those of an earlier frame.
  frame->depth = cv::Mat(camera.height_px, camera.width_px, CV_16UC1);
  frame->labels = cv::Mat(camera.height_px, camera.width_px, CV_16UC1);
  std::memcpy(frame->depth.data, buffer_.data() + kPoseBytes, image_bytes);
  std::memcpy(frame->labels.data, buffer_.data() + kPoseBytes + image_bytes, image_bytes);

  std::vector<bool> seen(65536, false);
  const uint16_t* labels = frame->labels.ptr<uint16_t>();
  for (size_t i = 0; i < countPixels(camera); ++i) seen[labels[i]] = true;
  frame->classes.clear();
  for (const LabelClass& label : header_.classes)
    if (seen[label.id]) frame->classes.push_back(label);
  frame->classes_evaluated = class_names_;
  return true;
}

void FrameFile::readHeader(std::istream* stream) {
  std::string line;
  int line_number = 1;
  if (!std::getline(*stream, line) || line != kMagic)
    fail("line 1", "not a recording", std::string(kMagic) + " in the first line");
  while (true) {
    ++line_number;
    if (!std::getline(*stream, line))
      fail("line " + std::to_string(line_number), "the header is cut off", "end");
    if (line == "end") break;
    readStatement(line, line_number);
  }
  if (header_.camera.width_px == 0 || header_.camera.fx_px == 0.0)
    fail("header", "size or camera is missing", "both before end");
}

void FrameFile::readStatement(const std::string& line, int line_number) {
  std::istringstream words(line);
  std::string key;
  words >> key;
  const bool ok = key == "size"        ? readSize(&words, &header_.camera)
                  : key == "camera"    ? readCamera(&words, &header_.camera)
                  : key == "class"     ? readClass(&words, &header_.classes)
                  : key == "predicate" ? readPredicate(&words, &header_.predicates)
                                       : key == "frames" && readCount(&words, &header_.n_frames);
  if (!ok) fail("line " + std::to_string(line_number), "got " + line, "a statement of the header");
}

void FrameFile::fail(const std::string& place, const std::string& problem,
                     const std::string& allowed) const {
  throw std::runtime_error(path_ + ": " + place + ": " + problem + "; allowed: " + allowed);
}

}  // namespace bench
}  // namespace core_perception
