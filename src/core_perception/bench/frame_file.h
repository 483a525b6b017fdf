// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <fstream>
#include <string>
#include <vector>

#include "core_perception/frame.h"
#include "core_perception/predicates.h"

namespace core_perception {
namespace bench {

/// What holds for every frame of a recording.
struct RecordingHeader {
  Camera camera;
  std::vector<LabelClass> classes;
  std::vector<Predicate> predicates;
  int n_frames = 0;
};

/// Reader of a recording of format "core_frames 1", a file or a pipe that is being written; one
/// frame is held at a time. The format is described in core_bringup/evaluation/frame_recording.py,
/// which writes it.
class FrameFile {
 public:
  /// @throws std::runtime_error "<file>: <place>: <problem>; allowed: <what>".
  explicit FrameFile(const std::string& path);

  const RecordingHeader& header() const { return header_; }
  /// Constraints of the header, stamped with the first frame.
  Constraints constraints() const;

  /// Reads the next frame, with images of its own; false at the end. Frame::classes lists the
  /// labels that are in the image, as a segmenter does; classes_evaluated lists all.
  bool next(Frame* frame);
  /// @throws std::runtime_error the recording is a pipe.
  void rewind();

 private:
  /// Pipes have no position.
  bool isFile() const { return first_frame_ >= 0; }
  void checkSize();
  void readHeader(std::istream* stream);
  void readStatement(const std::string& line, int line_number);
  [[noreturn]] void fail(const std::string& place, const std::string& problem,
                         const std::string& allowed) const;

  std::string path_;
  std::ifstream file_;
  std::streamoff first_frame_ = 0;
  RecordingHeader header_;
  std::vector<const LabelClass*> class_of_label_;  ///< 65536 entries, nullptr for none
  std::vector<std::string> class_names_;
  std::vector<char> buffer_;
  int n_read_ = 0;
};

}  // namespace bench
}  // namespace core_perception
