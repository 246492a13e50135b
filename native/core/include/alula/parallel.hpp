// A loop over independent items on several threads whose result cannot depend on their number.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "alula/control.hpp"

namespace alula {

// Number of worker threads for a request; 0 means one per available processor.
inline unsigned resolve_jobs(unsigned jobs) {
  const unsigned available = std::max(1u, std::thread::hardware_concurrency());
  return jobs == 0 ? available : std::min(jobs, 256u);
}

// Calls body(begin, end) for chunks that partition [0, count). Chunks are the same for every
// number of threads, so a body that writes only to slots of its own items (or its own chunk,
// begin / chunk) gives bit-identical results. The calling thread waits and polls `control`;
// an exception from a body or from `control` stops the remaining chunks and is rethrown.
template <class Body>
void parallel_chunks(std::size_t count, std::size_t chunk, unsigned jobs, Control& control, Body&& body) {
  chunk = std::max<std::size_t>(chunk, 1);
  const std::size_t chunks = (count + chunk - 1) / chunk;
  const unsigned threads = static_cast<unsigned>(std::min<std::size_t>(resolve_jobs(jobs), chunks));
  if (chunks == 0) return;
  std::atomic<std::size_t> next{0}, done{0};
  std::atomic<bool> stop{false};
  std::exception_ptr failure;
  std::mutex mutex;
  std::condition_variable finished;
  unsigned running = threads;

  auto worker = [&] {
    try {
      for (std::size_t c = next++; c < chunks && !stop; c = next++) {
        body(c * chunk, std::min(count, (c + 1) * chunk));
        ++done;
      }
    } catch (...) {
      const std::lock_guard lock(mutex);
      if (!failure) failure = std::current_exception();
      stop = true;
    }
    const std::lock_guard lock(mutex);
    if (--running == 0) finished.notify_all();
  };

  std::vector<std::jthread> pool;
  pool.reserve(threads);
  for (unsigned t = 0; t < threads; ++t) pool.emplace_back(worker);
  std::unique_lock lock(mutex);
  while (!finished.wait_for(lock, std::chrono::milliseconds(50), [&] { return running == 0; })) {
    lock.unlock();
    try {
      control.poll(done * chunk > count ? count : done * chunk, count);
      lock.lock();
    } catch (...) {
      lock.lock();
      if (!failure) failure = std::current_exception();
      stop = true;
    }
  }
  lock.unlock();
  pool.clear();
  if (failure) std::rethrow_exception(failure);
  control.poll(count, count);
}

}  // namespace alula
