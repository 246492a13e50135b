// Progress and interruption of long loops, independent of who calls them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <exception>

namespace alula {

// Receives progress. Loops call `poll` regularly from the calling thread; `poll` throws to stop the loop.
// `done` never decreases and never exceeds `total`.
class Control {
 public:
  virtual ~Control() = default;
  virtual void poll(std::size_t done, std::size_t total) { (void)done, (void)total; }
};

// Reports the progress of a loop as one part of a longer task: from `begin` to `end` of kWhole steps. The reported
// progress never decreases, whatever the loops inside report.
class Share final : public Control {
 public:
  static constexpr std::size_t kWhole = 1000;

  Share(Control& outer, std::size_t begin, std::size_t end) : outer_(outer), at_(begin), begin_(begin), end_(end) {}
  void poll(std::size_t done, std::size_t total) override {
    const double part = total == 0 ? 0 : static_cast<double>(done) / static_cast<double>(total);
    at_ = std::max(at_, begin_ + static_cast<std::size_t>(part * static_cast<double>(end_ - begin_)));
    outer_.poll(std::min(at_, end_), kWhole);
  }

 private:
  Control& outer_;
  std::size_t at_, begin_, end_;
};

// Allows a preparatory loop to be stopped without reporting its progress.
class InterruptOnly final : public Control {
 public:
  explicit InterruptOnly(Control& outer) : outer_(outer) {}
  void poll(std::size_t, std::size_t) override { outer_.poll(0, 1); }

 private:
  Control& outer_;
};

}  // namespace alula
