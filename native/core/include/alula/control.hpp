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

}  // namespace alula
