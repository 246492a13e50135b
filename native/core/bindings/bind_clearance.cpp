// Bindings of alula/clearance.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_clearance(nb::module_& m) { (void)m; }
