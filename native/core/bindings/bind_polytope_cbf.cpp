// Bindings of alula/polytope_cbf.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_polytope_cbf(nb::module_& m) { (void)m; }
