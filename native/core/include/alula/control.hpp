// Progress and interruption of long loops, independent of who calls them.
#pragma once

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

// Lets a preparatory loop be stopped without reporting its own progress.
class InterruptOnly final : public Control {
 public:
  explicit InterruptOnly(Control& outer) : outer_(outer) {}
  void poll(std::size_t, std::size_t) override { outer_.poll(0, 1); }

 private:
  Control& outer_;
};

}  // namespace alula
