"""The onboard C by itself: accuracy, independence of libraries and of the compiler's options."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from alula import _core
from alula.stages.filtering.protocol import FilterStatus
from support.paths import ROOT

OK, FILTERED, SHORTENED, RECOVERING, *_ = FilterStatus


def polytopes(rng, count):
    """Random convex hulls of points: normal (F, 3), offset (F), plane_start (count + 1)."""
    from scipy.spatial import ConvexHull

    planes = [
        ConvexHull(rng.uniform(-3, 3, 3) + rng.normal(scale=0.5, size=(rng.integers(5, 30), 3))).equations
        for _ in range(count)
    ]
    start = np.cumsum([0] + [len(rows) for rows in planes])
    stacked = np.vstack(planes)
    return np.ascontiguousarray(stacked[:, :3]), np.ascontiguousarray(-stacked[:, 3]), start


def test_exponential_and_logarithm_keep_their_stated_errors_over_all_floats():
    bits = np.arange(0, 0x7F800000, 1021, dtype=np.uint32)
    for sign in (0, 1 << 31):
        x = (bits | np.uint32(sign)).view(np.float32)
        exponential, logarithm = _core.onboard_exp_log(x)
        with np.errstate(all="ignore"):
            true = np.exp(x.astype(np.float64))
            normal = (true >= 1.18e-38) & (true <= 3.4028e38)
            assert (np.abs(exponential[normal] / true[normal] - 1) < 1e-7).all()
            assert (exponential[true < 1.17e-38] == 0).all()
            assert np.isinf(exponential[true > 3.4029e38]).all()
            positive = x > 0
            true_log = np.log(x[positive].astype(np.float64))
            assert (np.abs(logarithm[positive] - true_log) <= 1e-7 * np.abs(true_log)).all()
            assert np.isnan(logarithm[x < 0]).all()
    special = np.array([0, np.inf, -np.inf, np.nan], np.float32)
    assert np.array_equal(_core.onboard_exp_log(special)[0], [1, np.inf, 0, np.nan], equal_nan=True)
    assert np.array_equal(
        _core.onboard_exp_log(special)[1], [-np.inf, np.inf, np.nan, np.nan], equal_nan=True
    )


class Map(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("plane", "plane_start", "lower", "upper")),
        ("hull_count", ctypes.c_uint32),
        ("extent_m", ctypes.c_float),
        ("slack_m", ctypes.c_float),
    ]


class Config(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_float) for name in ("radius_m", "beta", "kappa", "dt_s", "v_max")),
        ("smoothing", ctypes.c_int),
        ("brute_force", ctypes.c_int),
    ]


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
@pytest.mark.parametrize("level", ["-O0", "-O3 -funroll-loops"])
def test_other_compilations_of_the_same_c_give_the_same_bits(tmp_path, level):
    library = tmp_path / "onboard.so"
    flags = f"-std=c99 -ffreestanding -ffp-contract=off -fno-math-errno -shared -fPIC {level}"
    sources = [str(path) for path in sorted((ROOT / "native/onboard/src").glob("*.c"))]
    include = f"-I{ROOT / 'native/onboard/include'}"
    subprocess.run(["cc", *flags.split(), include, *sources, "-o", str(library)], check=True)
    c = ctypes.CDLL(str(library))

    rng = np.random.default_rng(8)
    options = {"radius_m": 0.125, "beta": 4.0, "kappa": 64.0, "dt_s": 0.25, "v_max": 8.0}  # exact floats
    cbf = _core.PolytopeCbf(*polytopes(rng, 30), extent_m=20.0, **options)
    *arrays, extent, slack = cbf.map_arrays()
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]
    state = ctypes.create_string_buffer(1 << 15)
    made = c.alula_polytope_cbf_init(
        state,
        ctypes.byref(Map(*pointers, 30, extent, slack)),
        ctypes.byref(Config(*options.values(), 0, 0)),
    )
    assert made == 0
    result, seen = (ctypes.c_float * 8)(), set()
    for x, nominal in zip(
        rng.uniform(-4, 4, (300, 3)).astype(np.float32),
        rng.normal(scale=4.0, size=(300, 3)).astype(np.float32),
        strict=True,
    ):
        pair = [vector.ctypes.data_as(ctypes.c_void_p) for vector in (x, nominal)]
        status = c.alula_polytope_cbf_filter(state, *pair, result)
        u, want_status, margin, hard_margin, _ = cbf.filter(x.astype(float), nominal.astype(float))
        assert (list(result[:5]), status) == ([*u, margin, hard_margin], want_status)
        seen.add(status)
    assert {OK, FILTERED, SHORTENED, RECOVERING} <= seen


@pytest.mark.slow
@pytest.mark.skipif(not (shutil.which("cc") and shutil.which("nm")), reason="needs a C compiler and nm")
def test_the_onboard_objects_need_no_library(tmp_path):
    flags = "-std=c99 -O2 -ffreestanding -ffp-contract=off -fno-math-errno -Wall -Wextra -Wconversion -Werror"
    sources = sorted((ROOT / "native/onboard/src").glob("*.c"))
    assert sources
    defined, undefined = set(), set()
    for source in sources:
        target = tmp_path / f"{source.stem}.o"
        include = f"-I{ROOT / 'native/onboard/include'}"
        subprocess.run(["cc", *flags.split(), include, "-c", str(source), "-o", str(target)], check=True)
        listing = subprocess.run(["nm", str(target)], capture_output=True, text=True, check=True).stdout
        for line in listing.splitlines():
            (undefined if line.split()[-2] == "U" else defined).add(line.split()[-1])
    assert undefined <= defined
    assert all(name.startswith("alula_") for name in undefined)
