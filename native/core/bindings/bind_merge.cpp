// Bindings of alula/merge.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_merge(nb::module_& m) { (void)m; }
