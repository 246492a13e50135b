"""The cone filter of a double integrator in cbfpy, a CBF library on JAX, where it is installed.

It uses the fastest configuration found in which its solver converges: hard rows, each barrier divided by the
length of its row, tolerance 1e-5. With unscaled barriers, or a tolerance of 1e-8, the solver runs to its
limit of 30 iterations on most ticks, which takes two to three times as long; its defaults (relaxed, 1e-3)
take twice as long and are less exact. `unconverged` counts the ticks on which it did not converge.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from flights import Arena, Replay

from alula import _core

_COUNT = 64
_ALPHA = 5.0
_TOLERANCE = 1e-5
_FAR_M = 1e3  # beyond all obstacles
_MIN_SPEED = 0.2  # m/s, of the compared ticks: below it, cone-di has other rows


def is_there() -> bool:
    """Return whether cbfpy can be imported."""
    return importlib.util.find_spec("cbfpy") is not None


def _filter() -> tuple[Any, Any]:
    """Compile functions of (state, nominal, centres, matrices), in doubles: a tick, and its convergence."""
    os.environ |= {
        "JAX_PLATFORMS": "cpu",
        "JAX_ENABLE_X64": "1",
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    }
    import jax
    import jax.numpy as jnp
    import qpax
    from cbfpy import CBF, CBFConfig

    class Cone(CBFConfig):  # type: ignore[misc]
        """p' = v, v' = a, and h = beta gamma - delta^2 of every ellipsoid with h' >= -alpha h."""

        def __init__(self) -> None:
            far = np.tile([10.0, 10.0, 10.0], (_COUNT, 1))
            args = (far, np.tile(np.eye(3), (_COUNT, 1, 1)))
            super().__init__(n=6, m=3, relax_qp=False, solver_tol=_TOLERANCE, init_args=args)

        def f(self, z: Any, *_: Any) -> Any:
            return jnp.concatenate([z[3:], jnp.zeros(3)])

        def g(self, z: Any, *_: Any) -> Any:
            return jnp.vstack([jnp.zeros((3, 3)), jnp.eye(3)])

        def h_1(self, z: Any, centre: Any, a: Any) -> Any:
            r, v = centre - z[:3], z[3:]
            ar, av = jnp.einsum("kij,kj->ki", a, r), a @ v
            gamma, delta = jnp.einsum("ki,ki->k", r, ar) - 1, ar @ v
            row = gamma[:, None] * av - delta[:, None] * ar
            length = jnp.linalg.norm(2 * row, axis=1)
            return ((av @ v) * gamma - delta**2) / jax.lax.stop_gradient(length)

        def alpha(self, h: Any, *_: Any) -> Any:
            return _ALPHA * h

    cbf = CBF.from_config(Cone())

    def converges(*given: Any) -> Any:
        return qpax.solve_qp(*cbf.qp_data(*given), solver_tol=_TOLERANCE)[4]

    return jax.jit(cbf.safety_filter), jax.jit(converges)


_NAMES = ("ticks", "tick_p50_us", "tick_p99_us", "cone_di_p50_us", "filtered_ticks", "filtered_p50_us")
_NAMES += (
    "cone_di_filtered_p50_us",
    "difference_p50_m_s2",
    "difference_max_m_s2",
    "unconverged",
    "compile_s",
)


def figures(room: Arena, ticks: Replay, count: int, repeats: int = 3) -> dict[str, float | None]:
    """Time ticks after compilation [us], the minimum of a few runs each, and cone-di on the same ticks.

    Both get the 64 ellipsoids nearest to the vehicle and the same rows; the time of cbfpy is without finding
    them, ours is that of the whole Python call. `filtered` figures are of the ticks whose nominal input
    breaks a row, `difference` of these, between the two accelerations. Ticks inside an ellipsoid, at hardly
    any speed or without a solution are left out. All None without cbfpy.
    """
    found: dict[str, float | None] = {f"cbfpy_{name}": None for name in _NAMES}
    if is_there():
        with redirect_stdout(sys.stderr):
            found |= {
                f"cbfpy_{name}": value for name, value in _measured(room, ticks, count, repeats).items()
            }
    return found


def _measured(room: Arena, ticks: Replay, count: int, repeats: int) -> dict[str, float]:
    before, compile_s = time.perf_counter(), 0.0
    tick, converges = _filter()
    index = room.world.index
    pruning = _core.Pruning(count=_COUNT, floor_m=_FAR_M, approach=False, sweep=False)
    ours = _core.ConeDi(index, _core.ConeDiOptions(alpha=_ALPHA, lateral_bias=0.0, pruning=pruning))
    centres, matrices = index.grown()
    took, own, differences, filtered = [], [], [], []
    unconverged = 0
    for state, nominal in zip(ticks.state, ticks.acceleration, strict=True):
        if len(took) == count:
            break
        p, v = state[:3], state[6:9]
        near, _ = index.nearest(p.tolist(), p.tolist(), reach=_FAR_M, count=_COUNT)
        r = centres[near] - p
        inside = np.einsum("ki,kij,kj->k", r, matrices[near], r) < 1
        report = ours.filter(state.tolist(), nominal.tolist())
        slow = np.linalg.norm(v) < _MIN_SPEED
        if len(near) < _COUNT or slow or inside.any() or report["infeasible"]:
            continue
        given = (np.concatenate([p, v]), nominal, centres[near], matrices[near])
        answer = np.asarray(tick(*given))
        compile_s = compile_s or time.perf_counter() - before
        best = best_own = np.inf
        for _ in range(repeats):
            start = time.perf_counter()
            answer = np.asarray(tick(*given))
            middle = time.perf_counter()
            ours.filter(state.tolist(), nominal.tolist())
            best, best_own = min(best, middle - start), min(best_own, time.perf_counter() - middle)
        took.append(1e6 * best)
        own.append(1e6 * best_own)
        differences.append(np.abs(answer - report["acceleration"]).max())
        filtered.append(report["status"] != 0)
        unconverged += not converges(*given)
    if not any(filtered):
        return {}
    some = np.array(filtered)
    values: tuple[Any, ...] = (
        *(len(took), np.median(took), np.percentile(took, 99), np.median(own)),
        *(some.sum(), np.median(np.array(took)[some]), np.median(np.array(own)[some])),
        *(np.median(np.array(differences)[some]), np.max(np.array(differences)[some])),
        *(unconverged, compile_s),
    )
    return {name: float(value) for name, value in zip(_NAMES, values, strict=True)}
