// Control that reports to a Python callable and lets Ctrl-C stop a native loop.
#pragma once

#include <nanobind/nanobind.h>

#include <chrono>

#include "alula/base/control.hpp"

namespace alula {

// Made with the GIL held; poll() may be called without it. `progress` is None or a callable
// (done, total) -> None; it is called at most ten times a second and once at the end.
class PythonControl final : public Control {
 public:
  explicit PythonControl(nanobind::object progress) : progress_(std::move(progress)) {}

  void poll(std::size_t done, std::size_t total) override {
    const auto now = std::chrono::steady_clock::now();
    if (done != total && now - last_ < std::chrono::milliseconds(100)) return;
    last_ = now;
    const nanobind::gil_scoped_acquire gil;
    if (PyErr_CheckSignals() != 0) throw nanobind::python_error();
    if (!progress_.is_none()) progress_(done, total);
  }

 private:
  nanobind::object progress_;
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

}  // namespace alula
