// Bindings of alula/rollout.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_rollout(nb::module_& m) { (void)m; }
