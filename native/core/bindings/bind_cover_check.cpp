// Bindings of alula/cover_check.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_cover_check(nb::module_& m) { (void)m; }
