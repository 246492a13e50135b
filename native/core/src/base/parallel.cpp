#include "alula/base/parallel.hpp"

#include <chrono>

namespace alula {

void run_chunks(std::size_t count, std::size_t chunk, unsigned jobs, Control& control,
                void (*call)(void* body, std::size_t begin, std::size_t end, const Stop& stop), void* body) {
  chunk = std::max<std::size_t>(chunk, 1);
  const std::size_t chunks = (count + chunk - 1) / chunk;
  const unsigned threads = static_cast<unsigned>(std::min<std::size_t>(resolve_jobs(jobs), chunks));
  if (chunks == 0) return;
  std::atomic<std::size_t> next{0}, done{0};
  std::atomic<bool> stop{false};
  const Stop stopper(stop);
  std::exception_ptr failure;
  std::mutex mutex;
  std::condition_variable finished;
  unsigned running = threads;

  auto worker = [&] {
    try {
      for (std::size_t c = next++; c < chunks && !stop; c = next++) {
        const std::size_t begin = c * chunk, end = std::min(count, begin + chunk);
        call(body, begin, end, stopper);
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
