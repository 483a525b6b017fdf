// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "core_perception/instance_detector.h"

namespace core_perception {

/// Files of one run for parts of the map that lie far away, one a tile, each with a checksum. A
/// thread of its own reads and writes: no call waits for the disk unless it says so.
///
/// A tile whose file cannot be written stays in memory and is tried again; one whose file cannot be
/// read, or is not what was written, is lost. Beyond kMostTiles the one put here first is lost.
class TileStore {
 public:
  static constexpr size_t kMostTiles = 20000;  ///< at 0.2 m 0.8 square kilometres
  using Bytes = std::shared_ptr<const std::string>;
  enum class Answer { kNone, kPending, kReady, kLost };
  struct Status {
    size_t tiles = 0;         ///< away in all
    size_t unwritten = 0;     ///< of them in memory: not written yet, or the disk refused
    uint64_t lost = 0;        ///< since the start
    std::string write_error;  ///< why the last write failed; empty once one worked again
    std::string read_error;   ///< why the last tile was lost
  };

  /// Makes a folder of its own inside `parent`, and removes those that ended runs left there.
  /// @throws ParameterError it cannot be made.
  explicit TileStore(const std::string& parent);
  /// Removes the folder.
  ~TileStore();
  TileStore(const TileStore&) = delete;
  TileStore& operator=(const TileStore&) = delete;

  void put(const CellIndex& tile, std::string bytes);
  bool has(const CellIndex& tile) const;
  /// Begins to read a tile; does nothing for one that is not here.
  void prefetch(const CellIndex& tile);
  /// A tile that was read ahead is not wanted after all.
  void release(const CellIndex& tile);
  /// Gives a tile back, which then is no longer here. kPending: it is being read, ask again;
  /// kLost: it is not here any more either.
  /// @param wait for the disk, so that the answer is not kPending.
  Answer take(const CellIndex& tile, bool wait, Bytes* bytes);
  std::vector<CellIndex> list() const;
  /// Removes a tile.
  void forget(const CellIndex& tile);
  void clear();
  Status status() const;

 private:
  enum class State { kUnwritten, kOnDisk, kReading, kRead, kLost };
  struct Entry {
    uint64_t number = 0;  ///< grows with every put
    State state = State::kUnwritten;
    Bytes bytes;
  };
  struct Job {
    enum class Kind { kWrite, kRead, kRemove } kind;
    CellIndex tile;
    uint64_t number;
  };

  std::string pathOf(const Job& job) const;
  void push(Job::Kind kind, const CellIndex& tile, uint64_t number);
  void erase(std::map<CellIndex, Entry>::iterator it);
  void forgetOldest();
  void work();
  void write(const Job& job, std::unique_lock<std::mutex>* lock);
  void read(const Job& job, std::unique_lock<std::mutex>* lock);
  void retry();

  std::string folder_;
  int lock_file_ = -1;
  mutable std::mutex mutex_;
  std::condition_variable has_jobs_, has_answers_;
  std::map<CellIndex, Entry> entries_;
  std::deque<Job> jobs_;
  uint64_t last_number_ = 0, n_lost_ = 0;
  std::string write_error_, read_error_;
  bool ends_ = false;
  std::thread worker_;
};

}  // namespace core_perception
