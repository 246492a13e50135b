"""Settings that the papers print, beside those that we fly with, which are read at run time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from alula.schemas.encounters import SensorTable
from alula.schemas.filter_options import (
    ConeBackupParameters,
    GeofenceParameters,
    MovingFilterParameters,
    PolytopeCbfParameters,
)
from alula.schemas.vehicle import FASTBRIDGE
from alula.stages.compression.voxelize import sigma_of_confidence
from papers.verdicts import PaperRow, exact

_QUANTILE = 11.3449  # of the chi-square distribution with three degrees of freedom at 0.99


def settings_rows(paper: str) -> list[PaperRow]:
    """One row for each setting or group of settings that a paper prints.

    Args:
        paper: name of its folder in `examples`.
    """
    return {
        "polymerge": _polymerge,
        "fastbridge": _fastbridge,
        "dr-acbf": _dracbf,
        "geofencing": _geofencing,
    }[paper]()


def _row(
    item: str, quantity: str, published: str, printed: Sequence[float], ours: Sequence[float], why: str = ""
) -> PaperRow:
    same = all(math.isclose(a, b, rel_tol=1e-3) for a, b in zip(printed, ours, strict=True))
    words = ", ".join(exact(float(value)) for value in ours)
    verdict = "reproduced" if same else "not comparable"
    return PaperRow(item, f"setting: {quantity}", published, words, "", verdict, why)


def _polymerge() -> list[PaperRow]:
    return [
        _row(
            "section III-C",
            "sharpness κ of the smooth minimum and maximum [1/m]",
            "100",
            [100.0],
            [PolytopeCbfParameters().kappa_per_m],
            'our smoothing errs on the safe side; `smoothing = "printed"` is the paper\'s',
        ),
        PaperRow(
            *("section VI-D", "setting: tolerance of the goals of Table II", "5 cm", "5 cm", ""),
            *("reproduced", "flights.py"),
        ),
    ]


def _fastbridge() -> list[PaperRow]:
    body, rotors, gains = FASTBRIDGE.body, FASTBRIDGE.rotors, FASTBRIDGE.tracking
    assert body is not None
    assert rotors is not None
    assert gains is not None
    mass = body.mass_kg
    assert mass is not None
    policy = ConeBackupParameters()
    return [
        _row(
            "section II-A",
            "c² of an ellipsoid, the 99 % quantile of χ² with three degrees of freedom",
            "χ²₃,₀.₉₉ (11.345)",
            [_QUANTILE],
            [sigma_of_confidence(0.99) ** 2],
            "",
        ),
        _row(
            "IV-C",
            "mass [kg], half-span [m] and thrust [N] of the quadrotor",
            "0.461, 0.078, roughly 17",
            [0.461, 0.078, 17.0],
            [mass, abs(rotors.positions_m[0][0]), sum(rotors.max_thrust_n)],
            "inertia, torque ratio and minimum thrust are not printed; they are our choice",
        ),
        _row(
            "IV-B",
            "translational gains K_p, K_v",
            "3, 2",
            [3.0, 2.0],
            [gains.kp_per_s2, gains.kv_per_s],
            "read as accelerations",
        ),
        _row(
            "III-E, d",
            "fraction η_frac of the rotors' margin",
            "0.95",
            [0.95],
            [policy.eta_frac],
            "",
        ),
    ]


def _dracbf() -> list[PaperRow]:
    own, sensor = MovingFilterParameters(), SensorTable()
    rows = [
        _row(
            "section IV",
            "MPC: p T_s = H_max [s]",
            "p = 20, m = 3",
            [0.4],
            [20 * own.mpc.step_s],
            "T_s is not printed; 0.02 s makes the printed p as long as the printed H_max",
        ),
        _row(
            "section IV",
            "RP-CBF: horizon [s], disturbance samples",
            "3.0, 32",
            [3.0, 32.0],
            [own.rp_cbf.horizon_s, own.rp_cbf.samples],
        ),
        _row("section IV", "CBF-QP: horizon [s]", "0.4", [0.4], [own.cbf_qp.horizon_s]),
        _row(
            "section IV-A",
            "field of view [°], range [m] of the radar",
            "80 × 20, 150",
            [80.0, 20.0, 150.0],
            [
                math.degrees(2 * sensor.half_azimuth_rad),
                math.degrees(2 * sensor.half_elevation_rad),
                sensor.max_range_m,
            ],
            "its noise and its rate are not printed; they are our choice",
        ),
        _row(
            "section IV-A",
            "risk budget, H_min, H_max, d_cl, t_hd, t_s, k_s",
            "0.10, 0.15 s, 0.4 s, 1.0 m, 0.2 s, 0.5 s, 1.0",
            [0.10, 0.15, 0.4, 1.0, 0.2, 0.5, 1.0],
            [own.alpha, own.h_min_s, own.h_max_s, own.clearance_m, own.hold_s, own.stop_s, own.brake],
        ),
        _row(
            "section IV-A",
            "iterations and relaxation ω of the projection",
            "15, 1.0",
            [15.0, 1.0],
            [own.iterations, own.relaxation],
            'ours is exact by default; `solver = "gs"` is the printed iteration',
        ),
        _row(
            "section IV-A",
            "β and τ [s] of the trigger, Wasserstein radius ε",
            "0.05, 0.02, 0.05",
            [0.05, 0.02, 0.05],
            [own.tail, own.latency_s, own.wasserstein_m],
        ),
        PaperRow(
            *("section IV-A", "setting: gains of the sliding-mode differentiator (γ, L₀, L₁)", "1.5, 4, 3"),
            *(f"l₁ = {exact(own.l1)}, l₂ = {exact(own.l2)}", "", "not comparable"),
            "the equations have two gains l₁ and l₂, and the text does not say how the three make them",
        ),
        PaperRow(
            *("section IV-A", "setting: directions of avoidance", "the best of 12 (axis and diagonal)"),
            *("the best of 12", "", "reproduced"),
            "in the plane across the line of sight",
        ),
    ]
    return rows


def _geofencing() -> list[PaperRow]:
    own = GeofenceParameters()
    return [
        PaperRow(
            *("IV-B, eqs. 16 to 18", "setting: backup controller and backup set", "by their equations"),
            f"d = {exact(own.push_distance_m)} m, v_B = {exact(own.end_speed_m_s)} m/s, "
            f"T = {exact(own.steps * own.step_s)} s",
            *("", "not comparable", "the text at hand has lost its numbers; ours are of the published code"),
        ),
        _row(
            "V-B",
            "rate of the filter [Hz]",
            "400",
            [400.0],
            [1 / own.tick_s],
            "with the navigation data, as in the paper",
        ),
    ]
