"""The onboard filters on emulated Cortex-M4 and M7 cores: the host's bits, instructions, memory."""

import shutil
import struct
import sys
import zlib
from dataclasses import replace

import numpy as np
import pytest

from alula.schemas.parameters.targets import TARGETS
from alula.stages.compression.onboard.cost import obstacles_instructions, tick_instructions
from support.paths import ROOT

if not (ROOT / "benchmarks/emulated.py").is_file():
    pytest.skip("not a checkout", allow_module_level=True)
sys.path.append(str(ROOT / "benchmarks"))

import emulated

if missing := emulated.missing_tools():
    pytest.skip(missing, allow_module_level=True)

import onboard

FOREIGN, NEWER, TRUNCATED, DAMAGED, MALFORMED = 2, 3, 4, 5, 6  # of alula_map_status
CORES = ["m4", "m7"]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """All figures, and the folder of the firmware."""
    folder = tmp_path_factory.mktemp("emulated")
    return onboard.measure(folder, lambda what: None), folder


@pytest.fixture(scope="module")
def short(measured):
    """A small map, some ticks on it, and how to replay them."""
    from alula.stages.compression.onboard.layout import encode_map

    _, folder = measured
    image = encode_map(onboard.field(150), indexed=True)
    rng = np.random.default_rng(5)
    at = rng.uniform(-4, 4, (40, 3)).astype(np.float32)
    at[:, 2] /= 4
    nominal = rng.normal(size=(40, 3)).astype(np.float32)

    def again(core, raw=image, x=at, u=nominal):
        inputs = emulated.polytope_inputs(x, u, [8.0, 0.1, 2.0, 100.0, 0.01, 1.0])
        return emulated.replay(folder / "firmware", folder / "work", core, "polytope", inputs, raw)

    return image, at, nominal, again


def test_every_command_has_the_bits_of_the_host(measured):
    figures = measured[0].figures
    assert figures["host_target_mismatches"] == 0
    assert figures["ticks"] > 5000


def test_nothing_exceeds_its_budget_or_the_crazyflie(measured):
    assert onboard.complaints(measured[0].figures) == []


@pytest.mark.parametrize(
    "name",
    [
        "m4_dracbf_instructions",
        "m7_geofence_instructions",
        "m7_geofence_us",
        "m4_geofence_map_cycles_per_instruction",
        "code_bytes",
        "ram_bytes",
        "host_target_mismatches",
    ],
)
def test_what_exceeds_it_is_told(measured, name):
    said = onboard.complaints({**measured[0].figures, name: 10**7})
    assert len(said) >= 1
    assert any("10000000" in line for line in said)


def test_the_model_bounds_every_tick_and_not_by_much(measured):
    """What `alula export --target` says of a map holds of flights too; the model is fitted to such ticks."""
    for name, ratio in measured[0].tight.items():
        assert ratio.min() >= 1, name
        assert np.median(ratio) < 1.35, name


def test_instructions_do_not_depend_on_the_run(short):
    _, _, _, again = short
    for core in CORES:
        one, other = again(core), again(core)
        assert np.abs(one.instructions - other.instructions).max() <= 1  # of the counter's phase
        assert emulated.same_bits(one.ticks, other.ticks).all()


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
def test_both_cores_and_another_compiler_of_the_host_agree_in_every_field(measured, short):
    emulated.build(measured[1] / "firmware", "host")
    host, *targets = [short[3](core) for core in ("host", *CORES)]
    for target in targets:
        assert emulated.same_bits(host.ticks, target.ticks).all()


@pytest.mark.parametrize("core", CORES)
def test_what_is_not_finite_is_refused_on_the_target_too(short, core):
    _, at, nominal, again = short
    bad = np.array([np.nan, np.inf, -np.inf, 3e38, 9.0], np.float32)
    x, u = at[:10].copy(), nominal[:10].copy()
    x[:5, 1] = bad
    u[5:8, 2] = bad[:3]
    ticks = again(core, x=x, u=u).ticks
    assert (ticks["status"][:8] == 4).all()
    assert (ticks["u"][:8] == 0).all()
    assert (ticks["status"][8:] < 4).all()


@pytest.mark.parametrize("core", CORES)
def test_a_simulated_flight_is_flown_the_same_on_the_target(measured, monkeypatch, core):
    """What is flown with `world.onboard` in each tick is what the microcontroller commands."""
    from alula.schemas.scenarios.scenario import decoded
    from alula.stages.simulation.simulate import prepare
    from alula.stages.world import filters

    worlds, make = [], filters.make_filter
    monkeypatch.setattr(
        filters,
        "make_filter",
        lambda name, world, set_to: [worlds.append(world), make(name, world, set_to)][1],
    )
    scenario = decoded(
        {
            "vehicle": {"type": "single-integrator", "radius_m": 0.1},
            "world": {"cover": "x", "onboard": True},
            "safety": {"filters": ["polytope-cbf"]},
            "rules": {"trials": 2, "dt_s": 0.02, "max_time_s": 12.0},
        }
    )
    logs = prepare(scenario, cover=onboard.field(150)).fly(0, 2)
    (world,) = worlds
    options = scenario.safety.polytope_cbf
    x = np.concatenate([log["state"][:-1, :3] for log in logs])
    u_nom, u = (np.concatenate([log[name][:, :3] for log in logs]) for name in ("nominal", "command"))
    status, margin = (np.concatenate([log[name][:, 0] for log in logs]) for name in ("status", "margin"))
    up = [
        np.float32(v) if np.float32(v) >= v else np.nextafter(np.float32(v), np.float32(np.inf))
        for v in (world.extent_m, world.radius_m)
    ]
    inputs = emulated.polytope_inputs(
        x.astype(np.float32),
        u_nom.astype(np.float32),
        [*up, options.beta, options.kappa_per_m, world.dt_s, world.speed_m_s],
    )
    folder = measured[1]
    ticks = emulated.replay(folder / "firmware", folder / "work", core, "polytope", inputs, world.image).ticks
    assert (ticks["status"] == status).all()
    assert (ticks["margin_m"] == margin).all()
    changed = status > 0
    assert changed.sum() > 20
    assert (ticks["u"][changed] == u[changed].astype(np.float32)).all()
    assert (ticks["u"][~changed] == u_nom[~changed].astype(np.float32)).all()


def resealed(raw, at, value):
    image = bytearray(raw)
    image[at : at + len(value)] = value
    struct.pack_into("<I", image, 20, zlib.crc32(image[64:]))
    struct.pack_into("<I", image, 60, zlib.crc32(image[:60]))
    return bytes(image)


@pytest.mark.parametrize("core", CORES)
def test_maps_that_are_none_are_refused_on_the_target(short, core):
    image, _, _, again = short
    damaged = image[:100] + bytes([image[100] ^ 1]) + image[101:]
    cases = {
        b"ALMQ" + image[4:]: FOREIGN,
        resealed(image, 4, b"\2"): NEWER,
        damaged: DAMAGED,
        resealed(image, 12, struct.pack("<I", 10**6)): MALFORMED,
        resealed(image, 16, struct.pack("<I", 2**31)): TRUNCATED,
        resealed(image, 36, struct.pack("<f", -1.0)): MALFORMED,
        resealed(image, len(image) - 4, b"\0\0\0\0"): MALFORMED,
    }
    for raw, status in cases.items():
        found = again(core, raw=raw)
        assert found.set_up[0] == status
        assert len(found.ticks) == 0


def test_the_stack_used_stays_within_the_bound_of_the_call_graph(measured):
    figures = measured[0].figures
    outside = 400  # main() and the replay's own calls
    assert figures["m4_polytope_stack_bytes"] <= figures["stack_polytope_cbf_filter_bytes"] + outside
    assert figures["m4_dracbf_stack_bytes"] <= figures["stack_dr_acbf_filter_bytes"] + 1.5 * outside
    assert figures["m4_geofence_stack_bytes"] <= figures["stack_geofence_filter_bytes"] + 1.5 * outside
    assert figures["m4_stack_filter_stack_bytes"] <= figures["stack_stack_filter_bytes"] + 1.5 * outside
    assert figures["ram_bytes"] <= TARGETS["crazyflie"].ram_bytes


def test_a_tick_of_the_geofence_takes_no_longer_than_the_papers(measured):
    """350 µs on a Teensy 4.1 at 600 MHz, and its 400 Hz on a Crazyflie too, at 2 cycles per instruction."""
    figures = measured[0].figures
    assert figures["m7_geofence_us"] <= onboard.GEOFENCE_US
    assert figures["m7_geofence_us"] == figures["m7_geofence_instructions"] * 2 / 600
    assert figures["m4_geofence_instructions"] * 2 / TARGETS["crazyflie"].clock_hz < 1 / 400
    assert figures["m7_geofence_map_flight_instructions"] * 2 / TARGETS["teensy"].clock_hz < 1 / 400


@pytest.fixture(scope="module")
def fence(measured):
    """A recorded flight and how to replay it."""
    _, folder = measured
    flight, status, values = onboard.fence_ticks.record(onboard.fence_ticks.scenes()[3], 5)

    def again(core, flown=flight, raw=b""):
        inputs = emulated.geofence_inputs([flown], has_map=bool(raw))
        return emulated.replay(folder / "firmware", folder / "work", core, "geofence", inputs, raw)

    return flight, onboard.fence_ticks.Answered([flight], status, values), again


@pytest.mark.parametrize("core", CORES)
def test_recorded_flights_in_a_fence_are_flown_the_same_on_the_target(fence, core):
    flight, answered, again = fence
    assert {1, 2} & set(answered.status.tolist())
    assert onboard.fence_ticks.mismatches(answered, again(core)) == 0
    changed = replace(flight, pilots=flight.pilots * np.float32(1.01))
    assert onboard.fence_ticks.mismatches(answered, again(core, changed)) > 100


@pytest.mark.parametrize("core", CORES)
def test_navigation_and_sticks_that_are_no_numbers_are_refused_on_the_target(fence, core):
    flight, _, again = fence
    states, pilots = flight.states[:60].copy(), flight.pilots[:60].copy()
    states[:3, 4], states[20:30, 1] = np.inf, np.inf
    pilots[40:50, 2] = np.nan
    ticks = again(core, replace(flight, states=states, pilots=pilots)).ticks
    assert (ticks["status"][:3] == 5).all()
    assert (ticks["command"][:3] == 0).all()
    assert np.isfinite(ticks["command"]).all()
    assert (ticks["stale_s"][20:30] > 0).all()
    assert (ticks["status"][40:50] == 3).all()


@pytest.fixture(scope="module")
def stack(measured, short):
    """Recorded ticks of the stack and how to replay them."""
    _, folder = measured
    half = np.array(onboard.HALVES[150]) * onboard.G
    recorded = onboard.stack_ticks.record(short[0], half, seed=5)

    def again(core, inputs, raw=short[0]):
        return emulated.replay(folder / "firmware", folder / "work", core, "stack", inputs, raw)

    return recorded, again


@pytest.mark.parametrize("core", CORES)
def test_the_stack_flies_the_same_on_the_target(stack, core):
    recorded, again = stack
    assert {1, 3} <= set(recorded.status.tolist())
    assert onboard.stack_ticks.mismatches(recorded, again(core, recorded.inputs())) == 0
    changed = [row[:48] + struct.pack("<f", 0.05) + row[52:] for row in recorded.rows[:300]]
    other = replace(recorded, rows=changed)
    found = again(core, other.inputs())
    part = replace(
        recorded,
        **{name: getattr(recorded, name)[:300] for name in ("status", "values", "in_flight")},
    )
    assert onboard.stack_ticks.mismatches(part, found) > 50


@pytest.mark.parametrize("core", CORES)
def test_the_cost_that_export_counts_for_obstacles_covers_every_tick(stack, core):
    recorded, again = stack
    out = again(core, recorded.inputs())
    counts = [
        out.ticks[name].astype(np.int64) for name in ("boxes", "hulls", "planes", "made", "rows", "soft")
    ]
    counts[4] -= out.ticks["obstacle_rows"]
    work = np.column_stack(counts)
    beside = tick_instructions(work, of_chord=True) + obstacles_instructions(2)
    assert (out.instructions <= beside).all()
    assert out.instructions.max() > 0.3 * beside.max()


@pytest.mark.parametrize("core", CORES)
def test_a_stack_refuses_what_is_not_finite_and_flies_on(stack, core):
    recorded, again = stack
    rows = recorded.rows[:40].copy()
    rows[10] = rows[10][:12] + struct.pack("<f", np.nan) + rows[10][16:]  # velocity
    rows[20] = rows[20][:48] + struct.pack("<f", np.inf) + rows[20][52:]  # nominal
    ticks = again(core, replace(recorded, rows=rows).inputs()).ticks
    assert (ticks["status"] == 4).nonzero()[0].tolist() == [10, 20]
    assert np.isfinite(ticks["velocity"]).all()
    assert (ticks["velocity"][[10, 20]] == 0).all()


def test_a_tick_of_the_stack_fits_the_period_of_the_crazyflies_app(measured):
    """10 ms at 168 MHz and 2 cycles per instruction, among 150 hulls, in a fence, with two balls."""
    figures = measured[0].figures
    crazyflie = TARGETS["crazyflie"]
    assert figures["stack_m4_worst_instructions"] * 2 / crazyflie.clock_hz < 1 / crazyflie.rate_hz


@pytest.mark.parametrize("core", CORES)
def test_a_fence_around_a_damaged_map_flies_nothing(fence, short, core):
    _, _, again = fence
    image = short[0]
    found = again(core, raw=image[:100] + bytes([image[100] ^ 1]) + image[101:])
    assert found.set_up[0] == DAMAGED
    assert len(found.ticks) == 0
