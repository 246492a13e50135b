"""Plans for velocities and accelerations keep to what the vehicle's own autopilot follows; `fly` judges."""

import msgspec
import numpy as np
import pytest
from scipy.interpolate import PPoly

from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE, VelocitiesTable
from alula.stages.flight.mission import make_needs
from alula.stages.planning.limits import beyond_followed
from alula.stages.planning.plan import plan, resolve_plan
from alula.stages.vehicles.following import following_options, shaped_stop_s
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint
from support.flights.flights import BALL, mission
from support.scenes.small_scenes import box_cover

ROOM = box_cover([((0, 0, 0), (1, 1, 1))])
SLOW = msgspec.structs.replace(FASTBRIDGE, velocities=VelocitiesTable(horizontal_lag=(1.0, 0.3)))


def made(interface, vehicle=FASTBRIDGE):
    config = PlanConfig(
        beyond_map_m=7.0,
        start=(1.0, -6.0, 1.0),
        goal=(4.0, 3.0, 3.0),
        radius_m=0.25,
        speed_m_s=3.0,
        interface=interface,
    )
    return plan(resolve_plan(config, vehicle), cover=ROOM, vehicle=vehicle)


def peaks(found):
    """Largest acceleration, vertical acceleration and jerk, by scipy's derivatives."""
    curve = PPoly(np.moveaxis(found["coefficient"][:, :3, ::-1], 2, 0), found["time"])
    time = np.linspace(0, found["time"][-1], 5000)
    acceleration, jerk = (curve.derivative(order)(time) for order in (2, 3))
    return (
        np.linalg.norm(acceleration, axis=1).max(),
        abs(acceleration[:, 2]).max(),
        np.linalg.norm(jerk, axis=1).max(),
    )


@pytest.mark.parametrize("vehicle", [FASTBRIDGE, SLOW])
@pytest.mark.parametrize("interface", ["velocity", "acceleration"])
def test_a_plan_keeps_to_what_the_autopilot_follows(interface, vehicle):
    found = made(interface, vehicle)
    shaping = following_options(vehicle)
    level, vertical, jerk = peaks(found)
    assert level <= 0.601 * shaping.horizontal_acceleration_m_s2
    assert vertical <= 0.601 * shaping.vertical_acceleration_m_s2
    assert jerk <= 0.601 * shaping.horizontal_jerk_m_s3
    assert beyond_followed(found, vehicle) == ""
    # Those limits are of stops that take as long as the file says, less the inner loops.
    stop_s = shaped_stop_s(shaping.horizontal_acceleration_m_s2, shaping.horizontal_jerk_m_s3, 2.0)
    law = vehicle.following.horizontal_lag
    assert stop_s == pytest.approx(law[0] + 2 * law[1] - 0.08, rel=0.03)


def test_a_plan_for_body_rates_is_faster_and_no_plan_for_accelerations():
    found, slow = made("body-rates"), made("acceleration")
    assert found["time"][-1] < 0.9 * slow["time"][-1]
    words = beyond_followed(found, FASTBRIDGE)
    assert words.startswith(
        f"accelerates by {peaks(found)[0]:.3g} m/s^2, of which fastbridge follows 1.26 well"
    )
    assert "jerk" in words


def test_fly_refuses_it_by_accelerations_only():
    tight, slow = (
        mission("cone-di", scene=BALL, plan=made(interface), is_clear=True, allow_tight=False)
        for interface in ("body-rates", "acceleration")
    )
    holds, words = make_needs(tight, (AccelerationSetpoint, RatesSetpoint)).plan
    assert not holds
    assert "--interface acceleration" in words
    assert make_needs(tight, (RatesSetpoint,)).plan[0]
    assert make_needs(slow, (AccelerationSetpoint, RatesSetpoint)).plan[0]
    holds, words = make_needs(tight, (VelocitySetpoint,)).plan
    assert holds
    assert "will be late" in words
