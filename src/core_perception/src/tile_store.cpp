// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/tile_store.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <iterator>

#include "core_perception/exceptions.h"

namespace core_perception {
namespace {

const char kPrefix[] = "core_tiles_";
const char kLockName[] = "/lock";
const char kEnding[] = ".tile";
constexpr auto kRetryPeriod = std::chrono::seconds(10);

/// FNV-1a, 64 bits.
uint64_t computeChecksum(const std::string& bytes) {
  uint64_t hash = 14695981039346656037ull;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211ull;
  return hash;
}

std::vector<std::string> listFolder(const std::string& folder) {
  std::vector<std::string> names;
  DIR* directory = ::opendir(folder.c_str());
  if (directory == nullptr) return names;
  while (const dirent* entry = ::readdir(directory)) names.push_back(entry->d_name);
  ::closedir(directory);
  return names;
}

bool hasEnding(const std::string& text, const std::string& ending) {
  return text.size() > ending.size() &&
         text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

void removeFolder(const std::string& folder) {
  for (const std::string& name : listFolder(folder)) {
    if (hasEnding(name, kEnding)) ::unlink((folder + "/" + name).c_str());
  }
  ::unlink((folder + kLockName).c_str());
  ::rmdir(folder.c_str());
}

/// The lock of a folder, which its process holds as long as it lives; -1 when somebody holds it.
int lockFolder(const std::string& folder, int flags) {
  const int file = ::open((folder + kLockName).c_str(), flags | O_CLOEXEC, 0644);
  if (file < 0) return -1;
  if (::flock(file, LOCK_EX | LOCK_NB) == 0) return file;
  ::close(file);
  return -1;
}

void removeLeftovers(const std::string& parent) {
  for (const std::string& name : listFolder(parent)) {
    if (name.compare(0, std::strlen(kPrefix), kPrefix) != 0) continue;
    const int lock = lockFolder(parent + "/" + name, O_RDWR);
    if (lock < 0) continue;
    removeFolder(parent + "/" + name);
    ::close(lock);
  }
}

}  // namespace

constexpr size_t TileStore::kMostTiles;

TileStore::TileStore(const std::string& parent) {
  removeLeftovers(parent);
  folder_ = parent + "/" + kPrefix + "XXXXXX";
  const bool made = ::mkdtemp(&folder_[0]) != nullptr;
  if (made) lock_file_ = lockFolder(folder_, O_RDWR | O_CREAT);
  if (lock_file_ < 0) {
    const std::string reason = std::strerror(errno);
    if (made) removeFolder(folder_);
    throw ParameterError("map_dir", parent, "a folder that can be written to (" + reason + ")");
  }
  worker_ = std::thread([this] { work(); });
}

TileStore::~TileStore() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ends_ = true;
  }
  has_jobs_.notify_one();
  worker_.join();
  removeFolder(folder_);
  ::close(lock_file_);
}

/// A name that no other tile had: a file that is still to be removed is not the next one's.
std::string TileStore::pathOf(const Job& job) const {
  return folder_ + "/" + std::to_string(job.number) + kEnding;
}

void TileStore::push(Job::Kind kind, const CellIndex& tile, uint64_t number) {
  const Job job{kind, tile, number};
  kind == Job::Kind::kRead ? jobs_.push_front(job) : jobs_.push_back(job);  // reads are waited for
  has_jobs_.notify_one();
}

void TileStore::put(const CellIndex& tile, std::string bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto known = entries_.find(tile);
  if (known != entries_.end()) erase(known);
  if (entries_.size() >= kMostTiles) forgetOldest();
  Entry& entry = entries_[tile];
  entry.number = ++last_number_;
  entry.bytes = std::make_shared<const std::string>(std::move(bytes));
  push(Job::Kind::kWrite, tile, entry.number);
}

void TileStore::forgetOldest() {
  const auto oldest = std::min_element(
      entries_.begin(), entries_.end(),
      [](const auto& a, const auto& b) { return a.second.number < b.second.number; });
  ++n_lost_;
  read_error_ = "more than " + std::to_string(kMostTiles) + " tiles";
  erase(oldest);
}

void TileStore::erase(std::map<CellIndex, Entry>::iterator it) {
  push(Job::Kind::kRemove, it->first, it->second.number);
  entries_.erase(it);
}

bool TileStore::has(const CellIndex& tile) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return entries_.count(tile) > 0;
}

void TileStore::prefetch(const CellIndex& tile) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto it = entries_.find(tile);
  if (it == entries_.end() || it->second.state != State::kOnDisk) return;
  it->second.state = State::kReading;
  push(Job::Kind::kRead, tile, it->second.number);
}

void TileStore::release(const CellIndex& tile) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto it = entries_.find(tile);
  if (it == entries_.end()) return;
  Entry& entry = it->second;
  if (entry.state == State::kReading || entry.state == State::kRead) entry.state = State::kOnDisk;
  if (entry.state == State::kOnDisk) entry.bytes.reset();
}

TileStore::Answer TileStore::take(const CellIndex& tile, bool wait, Bytes* bytes) {
  prefetch(tile);
  std::unique_lock<std::mutex> lock(mutex_);
  const auto it = entries_.find(tile);
  if (it == entries_.end()) return Answer::kNone;
  const Entry& entry = it->second;
  if (wait) has_answers_.wait(lock, [&entry] { return entry.state != State::kReading; });
  if (entry.state == State::kReading) return Answer::kPending;
  const bool lost = entry.state == State::kLost;
  if (!lost) *bytes = entry.bytes;
  erase(it);
  return lost ? Answer::kLost : Answer::kReady;
}

std::vector<CellIndex> TileStore::list() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::vector<CellIndex> tiles;
  for (const auto& entry : entries_) tiles.push_back(entry.first);
  return tiles;
}

void TileStore::forget(const CellIndex& tile) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto it = entries_.find(tile);
  if (it != entries_.end()) erase(it);
}

void TileStore::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  while (!entries_.empty()) erase(entries_.begin());
}

TileStore::Status TileStore::status() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  Status status;
  status.tiles = entries_.size();
  for (const auto& entry : entries_) status.unwritten += entry.second.state == State::kUnwritten;
  status.lost = n_lost_;
  status.write_error = write_error_;
  status.read_error = read_error_;
  return status;
}

void TileStore::work() {
  std::unique_lock<std::mutex> lock(mutex_);
  auto next_retry = std::chrono::steady_clock::now() + kRetryPeriod;
  while (true) {
    has_jobs_.wait_until(lock, next_retry, [this] { return ends_ || !jobs_.empty(); });
    if (ends_) return;
    if (std::chrono::steady_clock::now() >= next_retry) {
      retry();
      next_retry = std::chrono::steady_clock::now() + kRetryPeriod;
    }
    if (jobs_.empty()) continue;
    const Job job = jobs_.front();
    jobs_.pop_front();
    if (job.kind == Job::Kind::kRemove) {
      lock.unlock();
      ::unlink(pathOf(job).c_str());
      lock.lock();
      continue;
    }
    const auto it = entries_.find(job.tile);
    if (it == entries_.end() || it->second.number != job.number) continue;  // taken meanwhile
    const State due = job.kind == Job::Kind::kWrite ? State::kUnwritten : State::kReading;
    if (it->second.state != due) continue;
    job.kind == Job::Kind::kWrite ? write(job, &lock) : read(job, &lock);
    has_answers_.notify_all();
  }
}

void TileStore::retry() {
  for (const auto& entry : entries_) {
    if (entry.second.state == State::kUnwritten)
      push(Job::Kind::kWrite, entry.first, entry.second.number);
  }
}

void TileStore::write(const Job& job, std::unique_lock<std::mutex>* lock) {
  const Bytes bytes = entries_[job.tile].bytes;
  lock->unlock();
  const uint64_t checksum = computeChecksum(*bytes);
  errno = 0;
  std::ofstream file(pathOf(job), std::ios::binary | std::ios::trunc);
  file.write(reinterpret_cast<const char*>(&checksum), sizeof(checksum));
  file.write(bytes->data(), static_cast<std::streamsize>(bytes->size()));
  file.close();
  const std::string reason = std::strerror(errno);
  if (!file) ::unlink(pathOf(job).c_str());
  lock->lock();
  write_error_ = file ? "" : pathOf(job) + ": " + reason;
  const auto it = entries_.find(job.tile);
  if (!file || it == entries_.end() || it->second.number != job.number) return;
  it->second.state = State::kOnDisk;
  it->second.bytes.reset();
}

void TileStore::read(const Job& job, std::unique_lock<std::mutex>* lock) {
  lock->unlock();
  std::ifstream file(pathOf(job), std::ios::binary | std::ios::ate);
  const std::streamoff size = file.tellg();
  uint64_t checksum = 0;
  std::string bytes;
  const bool opened = size >= static_cast<std::streamoff>(sizeof(checksum));
  if (opened) {
    bytes.resize(static_cast<size_t>(size) - sizeof(checksum));
    file.seekg(0);
    file.read(reinterpret_cast<char*>(&checksum), sizeof(checksum));
    file.read(&bytes[0], static_cast<std::streamsize>(bytes.size()));
  }
  const bool intact = opened && file.good() && computeChecksum(bytes) == checksum;
  lock->lock();
  const auto it = entries_.find(job.tile);
  const bool wanted = it != entries_.end() && it->second.number == job.number &&
                      it->second.state == State::kReading;
  if (!wanted) return;
  it->second.state = intact ? State::kRead : State::kLost;
  if (intact) {
    it->second.bytes = std::make_shared<const std::string>(std::move(bytes));
  } else {
    ++n_lost_;
    read_error_ = pathOf(job) + (opened ? ": not what was written" : ": cannot be read");
  }
}

}  // namespace core_perception
