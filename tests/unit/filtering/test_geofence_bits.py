"""The geofence compiled with other options gives the same bits, as on a microcontroller."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from alula import _core
from support.models import racer_model as model
from support.paths import ROOT

STATUS = ("passed", "blended", "backup", "no-pilot", "hand-over", "refused")


class Config(ctypes.Structure):
    _fields_ = [("word", ctypes.c_uint32 * 32)]


class Fence(ctypes.Structure):
    _fields_ = [
        ("has_box", ctypes.c_int),
        ("lower", ctypes.c_float * 3),
        ("upper", ctypes.c_float * 3),
        ("face_count", ctypes.c_uint32),
        ("face", ctypes.c_float * 128),
        ("keep_out", ctypes.c_void_p),
    ]


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
@pytest.mark.parametrize("level", ["-O0", "-O3 -funroll-loops"])
def test_other_compilations_of_the_geofence_give_the_same_bits(tmp_path, level):
    library = tmp_path / "onboard.so"
    flags = f"-std=c99 -ffreestanding -ffp-contract=off -fno-math-errno -shared -fPIC {level}"
    sources = sorted(str(path) for path in (ROOT / "native/onboard/src").glob("*.c"))
    include = f"-I{ROOT / 'native/onboard/include'}"
    subprocess.run(["cc", *flags.split(), include, *sources, "-o", str(library)], check=True)
    c = ctypes.CDLL(str(library))
    c.alula_geofence_defaults.restype = Config
    config, fence = c.alula_geofence_defaults(), Fence(has_box=1)
    for i in range(3):
        fence.lower[i], fence.upper[i] = model.BOX[0][i], model.BOX[1][i]
    filter_ = ctypes.create_string_buffer(8192)
    assert c.alula_geofence_init(filter_, ctypes.byref(fence), ctypes.byref(config)) == 0

    found = (ctypes.c_float * 6)()
    assert c.alula_geofence_examine(ctypes.byref(config), found) == 0
    conditions = _core.Geofence.conditions()
    names = ("rest_m_s", "most_rest_m_s", "upright", "least_upright", "lost_s", "most_beta")
    assert list(found) == [conditions[name] for name in names]

    geofence = _core.Geofence(_core.Fence(box=model.BOX))
    rng, seen = np.random.default_rng(0), set()
    states = model.random_states(300, 11, speed=25, tilt=2.5).astype(np.float32)
    pilots = rng.uniform([0, -12, -12, -6], [1, 12, 12, 6], (300, 4)).astype(np.float32)
    result = (ctypes.c_float * 11)()
    for k, (x, pilot) in enumerate(zip(states, pilots, strict=True)):
        has_state, has_pilot = k % 5 != 1, k % 7 != 1
        pair = [
            vector.ctypes.data_as(ctypes.c_void_p) if there else None
            for vector, there in ((x, has_state), (pilot, has_pilot))
        ]
        status = c.alula_geofence_filter(filter_, *pair, result)
        u, name, detail = geofence.filter(
            x.astype(float) if has_state else None, pilot.astype(float) if has_pilot else None
        )
        assert STATUS[status] == name
        assert list(result[:8]) == [
            *u,
            *(detail[key] for key in ("lambda", "h_i", "distance_m", "margin_m")),
        ]
        seen.add(name)
    assert {"blended", "backup", "no-pilot"} <= seen
