"""Vehicle files: the examples, the vehicles that they build, and errors that name the key."""

import subprocess
import sys

import msgspec
import numpy as np
import pytest

from alula._core import DoubleIntegrator, Plant
from alula.schemas.errors import InputError, UsageError, VersionError
from alula.schemas.scenarios.vehicle import FASTBRIDGE, check_vehicle, read_vehicle
from alula.stages.vehicles.bodies import plant, plant_options, quadrotor, tracking_gains
from support.paths import VEHICLES

EXAMPLES = VEHICLES
FILE = EXAMPLES / "fastbridge.toml"
WHOLE = FILE.read_text()
POINT = (EXAMPLES / "double-integrator.toml").read_text()
SINGLE = (EXAMPLES / "single-integrator.toml").read_text()


def read(tmp_path, text):
    path = tmp_path / "v.toml"
    path.write_text(text)
    return read_vehicle(path)


def test_the_default_vehicle_is_the_example():
    assert read_vehicle(EXAMPLES / "fastbridge.toml") == FASTBRIDGE
    check_vehicle(FASTBRIDGE)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_each_example_reads_and_flies(path):
    vehicle = read_vehicle(path)
    assert vehicle.name == path.stem
    if vehicle.model == "single-integrator":
        with pytest.raises(UsageError, match="single-integrator"):
            plant(vehicle)
        return
    flown = plant(vehicle, seed=1, trial=2)
    flown.reset(np.zeros(12))
    if vehicle.model == "double-integrator":
        assert isinstance(flown, DoubleIntegrator)
        flown.step(0.1, (1.0, 0.0, 0.0))
        assert flown.state[0] == pytest.approx(0.005)
        return
    assert isinstance(flown, Plant)
    body = quadrotor(vehicle)
    flown.step(0.01, np.array([body.hover_thrust, 0, 0, 0]))
    assert np.abs(flown.state).max() < 1e-15
    assert body.mass == vehicle.body.mass_kg
    assert 1.5 < body.max_thrust / body.hover_thrust < 9


def test_seven_examples_are_there():
    names = {path.stem for path in EXAMPLES.glob("*.toml")}
    points = {"double-integrator", "single-integrator"}
    assert names == {"fastbridge", "arducopter", "px4-sih", "crazyflie21", "racer7"} | points


def test_every_key_of_a_disturbance_reaches_the_plant(tmp_path):
    text = """
[disturbance]
motor_time_constant_s = 0.03
linear_drag_n_s_m = [0.1, 0.2, 0.3]
quadratic_drag_n_s2_m2 = [0.01, 0.02, 0.03]
wind_m_s = [1, -2, 0.5]
gust_m_s = [0.5, 0.5, 0.1]
gust_time_s = 2
position_noise_m = 0.001
velocity_noise_m_s = 0.01
attitude_noise_rad = 0.002
rate_noise_rad_s = 0.1
delay_s = 0.02
"""
    vehicle = read(tmp_path, WHOLE + text)
    assert set(msgspec.to_builtins(vehicle.disturbance)) == set(
        type(vehicle.disturbance).__struct_fields__
    )  # all differ from the default
    options = plant_options(vehicle)
    assert {name: getattr(options, name) for name in ("motor_time_constant_s", "gust_time_s")} == {
        "motor_time_constant_s": 0.03,
        "gust_time_s": 2.0,
    }
    assert options.linear_drag == pytest.approx([0.1, 0.2, 0.3])
    assert options.quadratic_drag == pytest.approx([0.01, 0.02, 0.03])
    assert options.wind_m_s == pytest.approx([1, -2, 0.5])
    assert options.gust_m_s == pytest.approx([0.5, 0.5, 0.1])
    sensor = options.sensor
    assert [
        sensor.position_noise_m,
        sensor.velocity_noise_m_s,
        sensor.attitude_noise_rad,
        sensor.rate_noise_rad_s,
        sensor.delay_s,
    ] == [0.001, 0.01, 0.002, 0.1, 0.02]


def test_attitude_gains_left_open_are_in_proportion_to_the_inertia(tmp_path):
    lines = [line for line in WHOLE.splitlines() if not line.startswith(("attitude_n_m", "rate_n_m_s"))]
    gains = tracking_gains(read(tmp_path, "\n".join(lines)))
    inertia = np.array([6.5e-4, 6.9e-4, 1.1e-3])
    assert np.divide(gains.k_r, inertia) == pytest.approx([500, 500, 110])
    assert np.divide(gains.k_omega, inertia) == pytest.approx([36, 36, 11])
    own = tracking_gains(FASTBRIDGE)
    assert (own.kp, own.kv, own.max_tilt_rad, own.max_thrust_share) == (3.0, 2.0, 1.0, 0.9)
    assert own.catch_up_m_s == np.inf
    assert own.k_r == pytest.approx([0.35, 0.35, 0.12])


def test_attitude_gains_left_open_are_slower_than_the_rate_loop():
    """PX4's own simulation, flown by faster ones, swung by 2 rad/s, lost thrust by that, and sank."""
    vehicle = read_vehicle(VEHICLES / "px4-sih.toml")
    gains, inertia = tracking_gains(vehicle), np.array(vehicle.body.inertia_kg_m2)
    damping = np.divide(gains.k_omega, inertia)
    assert damping * vehicle.rates.axes_s == pytest.approx([1.5, 1.5, 1.5])
    assert np.divide(gains.k_r, inertia) / damping**2 == pytest.approx(
        [500 / 36**2, 500 / 36**2, 110 / 11**2]
    )


def test_axes_that_a_file_turns_faster_than_its_rate_loop_are_named(tmp_path):
    assert {read_vehicle(path).axes_beyond_rate_loop() for path in VEHICLES.glob("*.toml")} == {""}
    text = (VEHICLES / "px4-sih.toml").read_text()  # roll follows within 0.1 s, yaw within 0.47 s
    swinging = replaced("[tracking]", "[tracking]\nrate_n_m_s = [0.9, 0.4, 0.2]", text)
    assert read(tmp_path, swinging).axes_beyond_rate_loop() == "xz"


def replaced(old, new, text=WHOLE):
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("", InputError, "is empty"),
        ("name = ", InputError, "is not TOML"),
        (WHOLE + "\n[rotors]\n", InputError, "is not TOML"),
        (replaced('version = "1.0"', 'version = "2.0"'), VersionError, "newer than"),
        (replaced('version = "1.0"', 'version = "x"'), UsageError, r"\$\.version"),
        (replaced("alula/vehicle", "alula/scenario"), UsageError, r"\$\.schema"),
        (replaced('"quadrotor"', '"hexarotor"'), UsageError, r"\$\.model"),
        (replaced("[body]", "[bodies]"), UsageError, "bodies"),
        (replaced("mass_kg", "mass_g"), UsageError, r"mass_g.*\$\.body"),
        (replaced("mass_kg = 0.461", "mass_kg = 0"), UsageError, r"> 0.*\$\.body\.mass_kg"),
        (replaced("mass_kg = 0.461", "mass_kg = nan"), UsageError, r"\$\.body\.mass_kg"),
        (replaced("mass_kg = 0.461", "mass_kg = inf"), UsageError, r"\$\.body\.mass_kg.*finite"),
        (replaced("mass_kg = 0.461", "mass_kg = 5.0"), UsageError, r"max_thrust_n.*cannot hover"),
        (replaced("mass_kg = 0.461", ""), UsageError, r"\$\.body\.mass_kg.*needs it"),
        (replaced("1.1e-3]", "1.1e-2]"), UsageError, r"\$\.body\.inertia_kg_m2.*no body"),
        (replaced("1.1e-3]", "1.1e-3, 1]"), UsageError, r"\$\.body\.inertia_kg_m2"),
        (replaced("spins = [-1", "spins = [0"), UsageError, r"\$\.rotors\.spins"),
        (replaced("= [4.25,", "= [-4.25,"), UsageError, r"\$\.rotors\.max_thrust_n"),
        (replaced("max_thrust_n", "min_thrust_n = [9, 0, 0, 0]\nmax_thrust_n"), UsageError, "must be below"),
        (replaced("max_rad_s = [10.0", "max_rad_s = [-1.0"), UsageError, r"\$\.rates\.max_rad_s"),
        (replaced("max_tilt_rad = 1.0", "max_tilt_rad = 1.6"), UsageError, r"\$\.tracking\.max_tilt_rad"),
        (replaced("max_thrust_share = 0.9", "max_thrust_share = 0.2"), UsageError, "max_thrust_share.*hover"),
        (WHOLE + "[limits]\nmax_speed_m_s = 1\n", UsageError, r"\$\.limits.*does not apply"),
        (WHOLE + "[disturbance]\nwind_m_s = [1, 0, 0]\n", UsageError, r"\$\.disturbance.*drag"),
        (WHOLE + "[disturbance]\ndelay_s = -1\n", UsageError, r"\$\.disturbance\.delay_s"),
        (WHOLE + "[disturbance]\nmotor_time_constant_s = inf\n", UsageError, "finite"),
        (replaced("max_acceleration_m_s2 = 12.0", "", POINT), UsageError, "max_acceleration_m_s2.*needs it"),
        (POINT + "[rates]\nmax_rad_s = [1, 1, 1]\n", UsageError, r"\$\.rates.*does not apply"),
        (POINT + "max_tilt_rad = 1\n", UsageError, r"\$\.tracking\.max_tilt_rad.*does not apply"),
        (POINT + "[disturbance]\nattitude_noise_rad = 1\n", UsageError, "attitude_noise_rad.*does not apply"),
        (WHOLE + "[assumed]\ndelay_s = 2\n", UsageError, r"\$\.assumed\.delay_s"),
        (POINT + "[assumed]\ndelay_s = 0.01\n", UsageError, r"\$\.assumed.*does not apply"),
        (SINGLE + "[tracking]\nkp_per_s2 = 4\n", UsageError, r"\$\.tracking.*does not apply"),
        (SINGLE + "max_acceleration_m_s2 = 4\n", UsageError, "max_acceleration_m_s2.*does not apply"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, error, message):
    with pytest.raises(error, match=message) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path))
    assert "\n" not in str(caught.value)


def test_a_process_that_read_a_vehicle_ends_well():
    """The decoder's types are taken apart at the end of a process; some shapes of types crash there."""
    code = "import pathlib, alula.schemas.scenarios.vehicle as v; "
    code += f"v.read_vehicle(pathlib.Path({str(FILE)!r}))"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_missing_file_and_bytes_that_are_no_text_are_input_errors(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        read_vehicle(tmp_path / "none.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not TOML"):
        read_vehicle(tmp_path / "b.toml")


def test_rotors_that_cannot_make_every_wrench_are_refused_by_name(tmp_path):
    vehicle = read(tmp_path, replaced("spins = [-1, -1, 1, 1]", "spins = [1, 1, 1, 1]"))
    with pytest.raises(UsageError, match=r"fastbridge: `\$\.rotors`: the rotors cannot make"):
        quadrotor(vehicle)
    with pytest.raises(UsageError, match="a quadrotor is needed"):
        quadrotor(read(tmp_path, POINT))
