// Bindings of alula/search.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_search(nb::module_& m) { (void)m; }
