"""Selection and figures of rows, compared with a row-by-row reference and NumPy."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.import_splat import import_splat, turned
from alula.stages.rotation import multiply_quat_wxyz
from support.effort import examples

FLOOR = np.float32(1e-9)
ODD = np.array([np.nan, np.inf, -np.inf, 0, -0.0, 1e-38, 3e38, 1e-12, 1, -2, 0.5], np.float32)


def scene(count, seed, odd=0.0):
    rng = np.random.default_rng(seed)

    def values(*shape):
        made = rng.normal(size=shape).astype(np.float32)
        return np.where(rng.random(shape) < odd, rng.choice(ODD, shape), made)

    arrays = [values(count, 3), np.abs(values(count, 3)), values(count, 4), np.abs(values(count))]
    return arrays, rng.integers(0, 256, (count, 3)).astype(np.uint8)


def reason_of(mean, scale, quat, opacity, min_opacity, crop, crop_sphere, max_scale):
    """The rules one after the other, in double precision."""
    if np.isnan([*mean, *scale, *quat, opacity]).any():
        return 1
    for why, values in ((2, mean), (3, scale), (4, quat)):
        if np.isinf(values).any():
            return why
    if not np.any(quat):
        return 5
    if opacity < min_opacity:
        return 6
    mean = mean.astype(np.float64)
    if crop is not None and ((mean < crop[:3]) | (mean > crop[3:])).any():
        return 7
    if crop_sphere is not None and ((mean - crop_sphere[:3]) ** 2).sum() > crop_sphere[3] ** 2:
        return 8
    return 9 if max_scale is not None and (scale > max_scale).any() else 0


@settings(max_examples=examples(150), deadline=None)
@given(
    st.integers(1, 300),
    st.integers(0, 2**32),
    st.sampled_from([0.0, 0.02, 0.3]),
    st.floats(0, 1, width=32),
    st.none() | st.just((-1.0, -2.0, -1.5, 1.0, 0.5, 2.0)),
    st.none() | st.just((0.25, 0.0, -0.5, 1.75)),
    st.none() | st.just(1.5),
)
def test_rows_are_left_out_for_the_first_reason(count, seed, odd, min_opacity, crop, crop_sphere, max_scale):
    arrays, color = scene(count, seed, odd)
    rules = {"min_opacity": min_opacity, "crop": crop, "crop_sphere": crop_sphere, "max_scale": max_scale}
    wanted = [reason_of(*row, **rules) for row in zip(*arrays, strict=True)]
    removal = np.empty(count, np.uint8)
    counts, first = _core.screen_rows(*arrays, removal, **rules)
    assert removal.tolist() == wanted
    assert list(counts) == np.bincount(wanted, minlength=10).tolist()
    assert first == next((i for i, why in enumerate(wanted) if 1 <= why <= 4), count)
    if 0 not in wanted:
        return
    check_kept(arrays, color, removal)


def check_kept(arrays, color, removal, **options):
    keep = removal == 0
    mean, scale, quat, opacity = (array[keep] for array in arrays)
    norm = np.linalg.norm(quat.astype(np.float64), axis=1, keepdims=True)
    wanted = {
        "mean": mean,
        "scale": np.maximum(scale, FLOOR),
        "quat": (quat / norm).astype(np.float32),
        "opacity": opacity,
        "color": color[keep],
    }
    made = {f"out_{name}": np.empty_like(values) for name, values in wanted.items()}
    figures = _core.keep_rows(*arrays, color, removal, scale_floor=FLOOR, **made, **options)
    for name, values in wanted.items():
        np.testing.assert_array_equal(made[f"out_{name}"], values)
    assert figures == _core.keep_rows(*arrays, color, removal, scale_floor=FLOOR, **options)
    longest = wanted["scale"].max(axis=1)
    assert list(figures["lower"]) == mean.min(axis=0).tolist()
    assert list(figures["upper"]) == mean.max(axis=0).tolist()
    assert figures["scale_max"] == longest.max()
    assert figures["scale_median"] == np.median(longest.astype(np.float64))
    assert figures["opacity_median"] == np.median(opacity.astype(np.float64))
    assert figures["floored"] == (scale < FLOOR).any(axis=1).sum()
    return made


def test_many_chunks_and_threads_give_the_same_bits():
    arrays, color = scene(70_001, 3)
    removal = (np.random.default_rng(0).random(70_001) < 0.3).astype(np.uint8)
    removal[20_000:50_000] = 2  # a whole chunk of which nothing stays
    one = check_kept(arrays, color, removal, jobs=1)
    for jobs in (2, 3):
        for name, values in check_kept(arrays, color, removal, jobs=jobs).items():
            assert values.tobytes() == one[name].tobytes()


OPACITIES = {
    "equal": np.ones(100_000),
    "two": np.arange(100_000) % 2,
    "sorted": np.linspace(0, 1, 99_999),
    "periodic": (np.arange(6 * 16_384) % 6 == 0) * 0.5 + np.arange(6 * 16_384) * 1e-9,  # misleads the sample
    "half and half": np.arange(50_000) >= 25_000,
    "one": [0.25],
    "pair": [0.25, 0.5],
}


@pytest.mark.parametrize("name", OPACITIES)
def test_medians_are_exact_whatever_the_sample_says(name):
    opacity = np.asarray(OPACITIES[name]).astype(np.float32)
    count = len(opacity)
    arrays, color = scene(count, 0)
    arrays[1][:] = opacity[:, None] + np.float32(1)
    check_kept([*arrays[:3], opacity], color, np.zeros(count, np.uint8))


def test_negative_zeros_are_bounds_of_zero():
    arrays, color = scene(3, 0)
    arrays[0][:] = -0.0
    figures = _core.keep_rows(*arrays, color, np.zeros(3, np.uint8), scale_floor=FLOOR)
    assert np.copysign(1, [*figures["lower"], *figures["upper"]]).tolist() == [1] * 6


def test_misuse_is_refused():
    arrays, color = scene(4, 0)
    removal = np.zeros(4, np.uint8)
    with pytest.raises(ValueError, match="different lengths"):
        _core.screen_rows(*arrays[:3], arrays[3][:3], removal, min_opacity=0)
    with pytest.raises(ValueError, match="different lengths"):
        _core.keep_rows(*arrays, color[:3], removal, scale_floor=FLOOR)
    with pytest.raises(ValueError, match="another length"):
        _core.keep_rows(*arrays, color, removal, scale_floor=FLOOR, out_mean=np.empty((3, 3), np.float32))
    with pytest.raises(ValueError, match="no row is kept"):
        _core.keep_rows(*arrays, color, removal + 1, scale_floor=FLOOR)
    with pytest.raises(TypeError):
        _core.keep_rows(*arrays, color, removal, scale_floor=FLOOR, out_mean=np.empty((4, 3)))


def splats(count, seed=0):
    arrays, color = scene(count, seed)
    arrays[3] /= arrays[3].max()
    names = ("mean", "scale", "quat_wxyz", "opacity")
    return Splats(format="ply", color=color, **dict(zip(names, arrays, strict=True)))


def test_arrays_that_do_not_change_are_not_copied_and_the_input_stays():
    given_ = splats(100)
    given_.opacity[:] = 0.5
    before = {
        name: getattr(given_, name).copy() for name in ("mean", "scale", "quat_wxyz", "opacity", "color")
    }
    made = import_splat(ImportSplatConfig(), given_)
    for name in ("mean", "scale", "opacity", "color"):
        assert np.shares_memory(made[name], getattr(given_, name))
    given_.scale[7] = 1e-12
    floored = import_splat(ImportSplatConfig(), given_)
    assert floored.manifest.source["scale_floored"] == 1
    assert (floored["scale"][7] == FLOOR).all()
    given_.scale[7] = before["scale"][7]
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(given_, name), values)


def test_arrays_of_another_layout_are_read_alike():
    given_ = splats(50)
    odd = Splats(
        format="ply",
        mean=np.asfortranarray(given_.mean),
        scale=given_.scale.astype(np.float64),
        quat_wxyz=np.repeat(given_.quat_wxyz, 2, axis=0)[::2],
        opacity=given_.opacity,
        color=given_.color,
    )
    config = ImportSplatConfig(min_opacity=0.3)
    one, two = import_splat(config, given_), import_splat(config, odd)
    for name in ("mean", "scale", "quat_wxyz", "opacity", "color"):
        assert one[name].tobytes() == two[name].tobytes()


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_half_turn_is_the_product_with_its_quaternion(axis):
    given_ = splats(500)
    half = np.zeros(4)
    half[1 + "xyz".index(axis)] = 1
    found = turned(given_, axis)
    wanted = multiply_quat_wxyz(half, given_.quat_wxyz).astype(np.float32)
    np.testing.assert_array_equal(found.quat_wxyz, wanted)
    given_.quat_wxyz[3] = np.inf  # stays what it is, and no NaN
    assert np.isinf(turned(given_, axis).quat_wxyz[3]).all()


_PEAK = """
import resource, sys
from pathlib import Path
import concurrent.futures
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.import_splat import import_splat
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
before = peak()
made = import_splat(ImportSplatConfig(), read_splats(Path(sys.argv[1])))
print(peak() - before, len(made["mean"]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has another unit")
def test_an_import_needs_little_more_than_its_input_and_output_arrays(tmp_path):
    count, names = (
        700_000,
        "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3",
    )
    path = tmp_path / "large.ply"
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    header += "".join(f"property float {name}\n" for name in names.split()) + "end_header\n"
    rows = np.random.default_rng(0).random((count, 14), np.float32)
    path.write_bytes(header.encode() + rows.tobytes())
    command = [sys.executable, "-P", "-c", _PEAK, str(path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    peak, kept = map(int, done.stdout.split())
    assert kept == count
    assert peak < 2.5 * 59 * count
