// A QP backend that is a Python callable.
#pragma once

#include <nanobind/nanobind.h>

#include "alula/qp/qp.hpp"

namespace alula {

// `callable(hessian (n, n), gradient (n,), rows (m, n), bounds (m,)) -> (status, x, active, multipliers)`, the
// status a number of `QpStatus`; None is no backend. It may be copied, called and destroyed without the GIL,
// which it takes itself; an exception of the callable comes out of QpSolver::solve.
QpBackend qp_backend(nanobind::object callable);

// The native solver, or one that calls the callable.
QpSolver qp_solver(nanobind::object callable);

}  // namespace alula
