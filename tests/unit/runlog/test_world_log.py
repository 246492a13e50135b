"""Logs of combined runs against the native log of the same flights."""

import io
import json

import numpy as np
import pytest
from mcap.reader import make_reader

from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION, RunRecord
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.world import write_world_log
from alula.stages.simulation.simulate import prepare
from support.flights.world_runs import flown, scenario_of
from support.scenes.fabricate import make_scene

FIELD = make_scene(60, low=(0, 0, 0), high=(6, 4, 3))
KEYS = {"trials": 1, "speed_m_s": 3.0, "log_rate_hz": 25.0, "which": "blocked"}


def logged(filters, interface, guide="none"):
    """Messages of a flight by topic, and its native log."""
    keys = KEYS | {"interface": interface, "guide": guide}
    ran = flown(filters, scene=FIELD, **keys)
    ready = prepare(scenario_of(filters, has_scene=True, **keys), FASTBRIDGE, scene=FIELD)
    (native,) = ready.fly(0, 1)
    record = RunRecord.of(
        Provenance.now(RUN_SCHEMA, RUN_VERSION, {}, None, []),
        name="test",
        filter=filters,
        vehicle=ran.vehicle,
        trials=ran.trials,
        summary=ran.summary,
        guarantee=ran.guarantee,
    )
    stream = io.BytesIO()
    write_world_log(
        stream,
        record,
        ran.flights,
        "world",
        dt_s=0.01,
        interface=interface,
        filters=ready.names,
        radii_m=[],
        radius_m=0.15,
        hulls=None,
        scene=FIELD,
        sigma=1.0,
        faces=np.empty((0, 4)),
    )
    found = {}
    stream.seek(0)
    for _, channel, message in make_reader(stream).iter_messages():
        found.setdefault(channel.topic, []).append(json.loads(message.data))
    return found, native


def of(vector):
    return [vector["x"], vector["y"], vector["z"]]


@pytest.mark.parametrize("interface", ["wrench", "body-rates"])
@pytest.mark.parametrize("name", ["cone-backup", "cone-di"])
def test_each_sample_is_the_tick_that_begins_then_and_the_last_one_the_end(name, interface):
    found, native = logged(name, interface)
    steps = len(native["mark"])
    ticks = [*range(0, steps, 4), steps]
    assert [message["time_s"] for message in found["/state"]] == pytest.approx([0.01 * k for k in ticks])
    for i, (k, state, safety) in enumerate(zip(ticks, found["/state"], found["/safety"], strict=True)):
        tick = min(k, steps - 1)
        np.testing.assert_allclose(of(state["position_m"]), native["state"][k, :3], atol=1e-6)
        np.testing.assert_allclose(state["rotor_thrust_n"], native["rotor_thrust"][tick], atol=1e-6)
        assert state["thrust_n"] == pytest.approx(native["command"][tick, 3], abs=1e-6)
        assert safety["status_name"] == FilterStatus(native["status"][tick, 0]).name.lower()
        for key in ("active", "candidates", "rows", "iterations"):
            assert safety[key] == native[key][tick, 0]
        assert safety["gate_m"] == pytest.approx(native["gate_m"][tick, 0], abs=1e-6)
        flags = native["flags"][tick, 0]
        assert [safety[key] for key in ("capped", "infeasible", "certified")] == [
            bool(flags & bit) for bit in (1, 2, 4)
        ]
        assert safety["saturated"] == bool(native["mark"][tick] & 4)
        np.testing.assert_allclose(of(safety["a_nom_m_s2"]), native["nominal"][tick], atol=1e-6)
        np.testing.assert_allclose(of(safety["a_safe_m_s2"]), native["a_command"][tick], atol=1e-6)
        assert safety["thrust_nom_n"] == pytest.approx(native["u_nominal"][tick, 0], abs=1e-6)
        np.testing.assert_allclose(of(safety["torque_nom_body_nm"]), native["u_nominal"][tick, 1:], atol=1e-6)
        since = slice(ticks[i - 1], k) if i else slice(0, 1)
        assert safety["realisation_error_m_s2"] == pytest.approx(native["a_error"][since].max(), abs=1e-6)
        assert ("rates_safe_rad_s" in safety) == (interface == "body-rates")
    assert sum(safety["status"] != 0 for safety in found["/safety"]) > 3


def test_a_guide_has_a_channel_of_its_own():
    found, native = logged("cone-ecbf", "wrench", guide="cone-di")
    for k, name in enumerate(("cone-di", "cone-ecbf")):
        status = [message["status"] for message in found[f"/safety/{name}"]]
        assert status[:-1] == native["status"][::4, k].tolist()
        assert any(status)
