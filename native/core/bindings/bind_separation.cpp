// Bindings of alula/separation.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_separation(nb::module_& m) { (void)m; }
