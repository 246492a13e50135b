// Parallel loops over independent items, with results that do not depend on the number of threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <mutex>
#include <thread>
#include <type_traits>
#include <vector>

#include "alula/base/control.hpp"

namespace alula {

// Number of worker threads for a requested number; 0 means one per available processor.
inline unsigned resolve_jobs(unsigned jobs) {
  const unsigned available = std::max(1u, std::thread::hardware_concurrency());
  return jobs == 0 ? available : std::min(jobs, 256u);
}

// Tells a body that the loop has been stopped, by an interruption or by an exception of another thread.
class Stop {
 public:
  explicit Stop(const std::atomic<bool>& flag) : flag_(flag) {}
  // Throws, to leave the body, once the loop has been stopped; the loop rethrows the cause. Costs one load.
  void check() const {
    if (flag_.load(std::memory_order_relaxed)) throw Stopped{};
  }

 private:
  struct Stopped {};
  const std::atomic<bool>& flag_;
};

// Calls `call(body, begin, end, stop)` for chunks: parallel_chunks, with its type of body erased, so that the loop is
// compiled once.
void run_chunks(std::size_t count, std::size_t chunk, unsigned jobs, Control& control,
                void (*call)(void* body, std::size_t begin, std::size_t end, const Stop& stop), void* body);

// Calls body(begin, end) or body(begin, end, stop) for chunks that partition [0, count). A body that may take longer
// than about 0.1 s calls `stop.check()` at least that often. Chunks are the same for every
// number of threads, so a body that writes only to slots of its own items (or its own chunk,
// begin / chunk) gives bit-identical results. The calling thread waits and polls `control`;
// an exception from a body or from `control` stops the remaining chunks and is rethrown.
template <class Body>
void parallel_chunks(std::size_t count, std::size_t chunk, unsigned jobs, Control& control, Body&& body) {
  using Plain = std::remove_reference_t<Body>;
  run_chunks(
      count, chunk, jobs, control,
      [](void* that, std::size_t begin, std::size_t end, const Stop& stop) {
        if constexpr (std::is_invocable_v<Plain&, std::size_t, std::size_t, const Stop&>)
          (*static_cast<Plain*>(that))(begin, end, stop);
        else
          (*static_cast<Plain*>(that))(begin, end);
      },
      const_cast<void*>(static_cast<const void*>(&body)));
}

// A pool of threads for many small batches of work, as in loops with steps that depend on each other.
class WorkerTeam {
 public:
  explicit WorkerTeam(unsigned jobs) {
    const unsigned helpers = std::min(resolve_jobs(jobs), kMost) - 1;
    for (unsigned t = 0; t < helpers; ++t) thread_.emplace_back([this, t] { serve(t + 1); });
  }
  ~WorkerTeam() {
    {
      const std::lock_guard lock(mutex_);
      round_ = kStop;
    }
    wake_.notify_all();
  }
  WorkerTeam(const WorkerTeam&) = delete;
  WorkerTeam& operator=(const WorkerTeam&) = delete;

  std::size_t size() const { return thread_.size() + 1; }

  // Calls body(worker, item) for each item below `count`, worker < size(), and waits; an exception
  // of a body is rethrown once all have ended.
  template <class Body>
  void run(std::size_t count, Body&& body) {
    if (thread_.empty() || count < 2) {
      for (std::size_t i = 0; i < count; ++i) body(std::size_t{0}, i);
      return;
    }
    using Plain = std::remove_reference_t<Body>;
    call_ = [](void* that, std::size_t worker, std::size_t item) { (*static_cast<Plain*>(that))(worker, item); };
    body_ = &body;
    count_ = count;
    next_ = 0;
    failure_ = nullptr;
    {
      const std::lock_guard lock(mutex_);
      is_open_ = true;
      ++round_;
    }
    wake_.notify_all();
    work(0);
    {
      const std::lock_guard lock(mutex_);
      is_open_ = false;  // threads that have not joined this batch by now stay out of it
    }
    while (busy_ != 0) std::this_thread::yield();
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  static constexpr unsigned kMost = 16;  // batches are small
  static constexpr int kPatience = 400;  // polls for work before a thread sleeps
  static constexpr std::uint64_t kStop = UINT64_MAX;

  void work(std::size_t worker) {
    try {
      for (std::size_t i = next_++; i < count_; i = next_++) call_(body_, worker, i);
    } catch (...) {
      const std::lock_guard lock(mutex_);
      if (!failure_) failure_ = std::current_exception();
    }
  }

  void serve(std::size_t worker) {
    for (std::uint64_t seen = 0;;) {
      for (int i = 0; i < kPatience && round_ == seen; ++i) std::this_thread::yield();
      {
        std::unique_lock lock(mutex_);
        wake_.wait(lock, [&] { return round_ != seen; });
        seen = round_;
        if (seen == kStop) return;
        if (!is_open_) continue;
        ++busy_;
      }
      work(worker);
      --busy_;
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_;
  std::atomic<std::uint64_t> round_{0};
  std::atomic<std::size_t> next_{0}, busy_{0};
  bool is_open_ = false;
  std::size_t count_ = 0;
  void (*call_)(void*, std::size_t, std::size_t) = nullptr;
  void* body_ = nullptr;
  std::exception_ptr failure_;
  std::vector<std::jthread> thread_;
};

}  // namespace alula
