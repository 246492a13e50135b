// Progress and interruption of long loops, independent of who calls them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <exception>

namespace alula {

// Asked from the calling thread now and then; throws to stop the loop.
// `done` never decreases and never exceeds `total`.
class Control {
 public:
  virtual ~Control() = default;
  virtual void poll(std::size_t done, std::size_t total) { (void)done, (void)total; }
};

// Reports a loop as one part of a longer whole: from `begin` to `end` of kWhole steps. What it
// reports never decreases, whatever the loops inside it report.
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

// Lets a preparatory loop be stopped without reporting its own progress.
class InterruptOnly final : public Control {
 public:
  explicit InterruptOnly(Control& outer) : outer_(outer) {}
  void poll(std::size_t, std::size_t) override { outer_.poll(0, 1); }

 private:
  Control& outer_;
};

}  // namespace alula
