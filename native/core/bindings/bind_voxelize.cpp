// Bindings of alula/voxelize.hpp.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_voxelize(nb::module_& m) { (void)m; }
