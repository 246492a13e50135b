"""SPZ and `.splat`: errors stay within the recorded bounds, for other writers and for alula."""

import gzip

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import InputError
from alula.stages.reconstruction.formats.splat import decode_splat, encode_splat
from alula.stages.reconstruction.formats.spz import encode_spz
from support.effort import examples
from support.files.spz_files import (
    arrays_of,
    differences,
    file_of,
    random_scene,
    read,
    within,
)


def reference_codes(scene, version):
    """Arrays as Niantic's writer makes them: in single precision, rounding halves away from zero."""
    one = np.float32(1)

    def rounded(values):
        return np.trunc(values + np.copysign(np.float32(0.5), values))

    fixed = rounded(scene.mean * np.float32(4096)).astype("<i4").view(np.uint8).reshape(-1, 4)[:, :3]
    log_scale = np.log(scene.scale.astype(np.float64)).astype(np.float32)
    quat = scene.quat_wxyz / np.sqrt((scene.quat_wxyz**2).sum(axis=1, dtype=np.float32))[:, None]
    xyzw = np.roll(quat, -1, axis=1)
    if version == 2:
        xyzw = xyzw * np.where(xyzw[:, 3:] < 0, np.float32(-127.5), np.float32(127.5)) + np.float32(127.5)
        rotations = np.clip(rounded(xyzw[:, :3]), 0, 255).astype(np.uint8)
    else:
        rotations = np.empty(len(scene), "<u4")
        for row, q in enumerate(xyzw):
            largest = int(np.abs(q).argmax())
            code = largest
            for place in range(4):
                if place != largest:
                    negative = (q[place] < 0) != (q[largest] < 0)
                    magnitude = int(
                        np.float32(511) * (abs(q[place]) / np.float32(0.5**0.5)) + np.float32(0.5)
                    )
                    code = code << 10 | negative << 9 | magnitude
            rotations[row] = code
    logit = np.log(scene.opacity.astype(np.float64) / (1 - scene.opacity.astype(np.float64))).astype(
        np.float32
    )
    return {
        "positions": np.ascontiguousarray(fixed).tobytes(),
        "alphas": rounded(one / (one + np.exp(-logit)) * np.float32(255)).astype(np.uint8).tobytes(),
        "colors": bytes(3 * len(scene)),
        "scales": rounded((log_scale + np.float32(10)) * np.float32(16)).astype(np.uint8).tobytes(),
        "rotations": rotations.tobytes(),
        "sh": b"",
    }


@pytest.mark.parametrize("version", [2, 3])
def test_what_the_reference_writer_loses_is_within_the_bounds_and_close_to_them(version):
    scene = random_scene(np.random.default_rng(version), 20_000)
    scene.opacity[:] = np.clip(scene.opacity, 0.001, 0.999)
    found = read(file_of(version, len(scene), reference_codes(scene, version)))
    assert (within(scene, found) > 0.9).all()
    most = float(np.degrees(found.loss.bound[:, 2].max()))
    assert 17 < most < 18.2 if version == 2 else most < 0.28


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("version", [3, 4])
def test_what_gsply_loses_is_within_the_bounds(tmp_path, version):
    gsply = pytest.importorskip("gsply")
    scene = random_scene(np.random.default_rng(version), 5000)
    scene.opacity[:] = np.clip(scene.opacity, 0.001, 0.999)
    opacity = scene.opacity.astype(np.float64)
    written = gsply.GSData.from_arrays(
        means=scene.mean,
        scales=np.log(scene.scale),
        quats=scene.quat_wxyz,
        opacities=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh0=np.zeros((5000, 3), np.float32),
        format="ply",
    )
    pytest.importorskip("gsply.spz").write_spz(tmp_path / "a.spz", written, version=version)
    assert (within(scene, read((tmp_path / "a.spz").read_bytes())) > 0.9).all()


@pytest.mark.parametrize("cut", [False, True])
def test_centres_of_half_precision_are_lost_by_no_more_than_recorded(cut):
    rng = np.random.default_rng(1)
    mean = rng.normal(size=(20_000, 3)) * 10.0 ** rng.uniform(-8, 3, (20_000, 1))
    half = mean.astype("<f2")
    if cut:
        half = np.where(np.abs(half) > np.abs(mean), np.nextafter(half, np.float16(0)), half).astype("<f2")
    arrays = arrays_of(rng, 1, len(mean)) | {"positions": half.tobytes()}
    found = read(file_of(1, len(mean), arrays))
    off = np.linalg.norm(found.mean - mean, axis=1) / found.loss.bound[:, 0]
    assert (0.9 if cut else 0.45) < off.max() <= 1
    assert "position" not in found.loss.unbounded
    arrays["positions"] = np.where(half == half[7, 1], 40000, half).astype("<f2").tobytes()
    assert "outer half" in read(file_of(1, len(mean), arrays)).loss.unbounded["position"]


def test_what_cannot_be_bounded_is_said():
    scene = random_scene(np.random.default_rng(0), 10, reach=1)
    arrays = reference_codes(scene, 3)
    assert not read(file_of(3, 10, arrays)).loss.unbounded
    arrays["positions"] = b"\xff\xff\x7f" + arrays["positions"][3:]
    arrays["scales"] = b"\xff\0\xff" + arrays["scales"][3:]
    found = read(file_of(3, 10, arrays))
    assert found.loss.unbounded["position"].startswith("1 centres lie in the outer half")
    assert found.loss.unbounded["scale"].startswith("1 Gaussians have a semi-axis of 379")


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 300), st.floats(-12, 22), st.sampled_from([2, 3, 4]))
def test_what_is_written_is_read_again_within_the_bounds(seed, count, reach, version):
    scene = random_scene(np.random.default_rng(seed), count, reach=2.0**reach)
    raw = b"".join(encode_spz(scene, version, "a line"))
    assert raw == b"".join(encode_spz(scene, version, "a line"))
    found = read(raw)
    within(scene, found)
    assert not found.loss.unbounded
    assert np.abs(scene.color.astype(int) - found.color).max() <= 1
    assert len(found.notes) == 1  # of the frame
    if reach < 9:
        assert found.loss.bound[0, 0] <= max(2e-4 / 0.9, 2.0**-22)
    if version < 4:
        inflated = gzip.decompress(raw)
        assert inflated[4] == version
        assert raw[4:8] == bytes(4)


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 300))
def test_a_splat_that_is_written_is_read_again_within_the_bounds(seed, count):
    scene = random_scene(np.random.default_rng(seed), count)
    raw = b"".join(encode_splat(scene))
    assert len(raw) == 32 * count
    found = decode_splat(memoryview(raw))
    within_rotation = differences(scene, found)
    assert (within_rotation <= found.loss.bound).all()
    np.testing.assert_array_equal(found.mean, scene.mean)
    np.testing.assert_array_equal(found.scale, scene.scale)
    np.testing.assert_array_equal(found.color, scene.color)
    assert np.abs(found.opacity - scene.opacity).max() <= 1 / 510 + 1e-7


def test_extreme_values_are_written_or_refused():
    scene = random_scene(np.random.default_rng(0), 4)
    scene.scale[0] = [0, 1e-9, 391]
    scene.quat_wxyz[:] = [[-1, 0, 0, 0], [0, -2, 0, 0], [1, 1, 1, 1], [0, 0, 0, -1]]
    scene.opacity[:] = [0, 1, 0.5, 1e-4]
    for version in (2, 3, 4):
        found = read(b"".join(encode_spz(scene, version)))
        within(scene, found)
        assert found.scale[0, 0] == np.float32(np.exp(-10))
    scene.scale[1, 1] = 392
    with pytest.raises(InputError, match="1 Gaussians have a semi-axis longer than the 391"):
        encode_spz(scene)
    scene.scale[1, 1], scene.mean[2, 0] = 1, 2**22
    assert read(b"".join(encode_spz(scene))).mean[2, 0] == 2**22
    scene.mean[2, 0] = -(2**22) - 1
    with pytest.raises(InputError, match="SPZ holds at most 4194304"):
        encode_spz(scene)
