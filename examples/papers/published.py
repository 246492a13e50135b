"""Published values of the papers."""

from __future__ import annotations

from typing import Any

# PolyMerge, Table I: scene, hulls and half-planes (in thousands as printed).
POLYMERGE_SCENES = (
    ("Bicycle", 3296, 258_000),
    ("Flowers", 2624, 209_000),
    ("Garden", 1006, 80_000),
    ("Stump", 2458, 207_000),
    ("Treehill", 2681, 217_000),
    ("Room", 454, 33_000),
    ("Counter", 1367, 82_000),
    ("Kitchen", 901, 69_000),
    ("Bonsai", 2080, 172_000),
)
# Further columns, in the same order: ellipsoids, their file [MB], half-planes of SuGaR + CoACD, its
# file [MB], the hulls' file [MB].
POLYMERGE_SIZES = (
    (1_500_000, 671.1, 189_000, 13.5, 60.7),
    (1_540_000, 692.0, 149_000, 10.6, 49.8),
    (1_610_000, 718.7, 58_000, 4.2, 20.1),
    (1_470_000, 659.8, 150_000, 10.7, 67.3),
    (1_440_000, 644.2, 150_000, 10.7, 58.8),
    (1_060_000, 473.6, 26_000, 1.8, 8.5),
    (1_430_000, 640.3, 76_000, 5.6, 10.6),
    (1_370_000, 612.5, 53_000, 3.8, 17.4),
    (1_400_000, 626.7, 119_000, 8.5, 39.4),
)
# PolyMerge, Table II: hulls, control rate [Hz], success, minimum distance [m].
POLYMERGE_FLIGHTS = (
    (10, 500, 0.7, 0.268),
    (30, 250, 0.8, 0.253),
    (50, 250, 1.0, 0.098),
    (100, 167, 0.8, 0.117),
    (150, 125, 0.9, 0.097),
)
# FastBridge, section IV-B, and the table of Figure 4.
FASTBRIDGE: dict[str, dict[str, float]] = {
    "comparison": {
        "mean_jerk_ratio": 0.53,
        "max_jerk_ratio": 0.54,
        "time_ratio": 1 / 2.25,
        "top_speed_m_s": 4.5,
        "baseline_top_speed_m_s": 3.5,
    },
    "flight": {
        "loop_max_us": 34836,
        "loop_p99_us": 21043,
        "loop_mean_us": 12318,
        "overruns": 1,
        "ticks": 822,
        "feasible": 755 / 822,
        "infeasible": 67,
        "min_clearance_m": 0.154,
        "mean_speed_m_s": 0.378,
        "max_speed_m_s": 1.481,
    },
}
# DR-ACBF (arXiv 2512.00462), Tables I to V: values of the first and second obstacle, or their mean; success
# [%], closing speed [m/s], reaction, command and processing times [ms], separation [m].
DRACBF: dict[str, dict[str, dict[str, float]]] = {
    "scenario-1": {
        name: {
            **{
                "success_1": s1,
                "success_2": s2,
                "reaction": tr,
                "command": tcm,
                "tick": tick,
                "tick_std": std,
            },
            **{"closing_1": 10.43, "closing_2": 10.97, "separation_1": 2.82, "separation_2": d2},
        }
        for name, s1, s2, tr, tcm, tick, std, d2 in (
            ("mpc", 99.52, 99.89, 10.07, 3.22, 0.956, 0.666, 6.64),
            ("cbf-qp", 99.51, 99.84, 10.02, 2.20, 0.714, 0.476, 6.65),
            ("rp-cbf", 99.52, 99.89, 59.83, 2.08, 0.642, 0.416, 6.64),
            ("dr-acbf", 99.48, 99.80, 10.03, 1.40, 0.444, 0.270, 6.64),
        )
    },
    "scenario-2": {
        name: {
            **{"success_mean": s, "closing_mean": v, "reaction": tr, "command": tcm, "tick": tick},
            "separation_mean": d,
        }
        for name, s, v, tr, tcm, tick, d in (
            ("dr-acbf", 82.5, 8.18, 12.74, 2.24, 0.475, 1.881),
            ("h-max-0.2", 79.8, 8.16, 11.88, 1.58, 0.312, 1.822),
            ("h-max-0.8", 82.5, 8.28, 12.35, 1.85, 0.382, 2.105),
            ("clearance-1", 82.3, 8.02, 12.87, 2.07, 0.234, 1.864),
            ("clearance-4", 77.6, 7.16, 12.16, 1.66, 0.423, 2.054),
            ("hold-0.1", 82.6, 7.10, 11.92, 1.72, 0.362, 1.924),
            ("hold-0.4", 82.6, 8.18, 12.17, 1.97, 0.403, 1.945),
        )
    },
    "trigger": {
        "dr-acbf": {"success_1": 80.0, "success_2": 84.7, "separation_1": 2.969, "separation_2": 0.985},
        "trigger-simple": {
            "success_1": 32.0,
            "success_2": 37.9,
            "separation_1": 0.707,
            "separation_2": 0.858,
        },
    },
    "solver": {
        "dr-acbf-gs": {"tick": 0.475, "command": 2.24},
        "dr-acbf-qp": {"tick": 0.766, "command": 5.36},
    },
    "hardware": {
        name: {
            **{"closing": v, "reaction": tr, "command": tcm, "avoid": ta, "detection": td, "separation": d},
            "success": 100.0,
        }
        for name, v, tr, tcm, ta, td, d in (
            ("thrown/1", 3.10, 66.6, 60.3, 239.0, 3209.0, 0.479),
            ("moving/1", 3.40, 78.8, 66.4, 223.0, 2708.0, 0.351),
            ("both/1", 2.35, 61.5, 41.5, 180.0, 671.0, 0.325),
            ("both/2", 1.49, 99.4, 78.7, 217.0, 4246.0, 0.685),
        )
    },
}
# Tables IV and V: every single flight.
_DRACBF_FLIGHTS: dict[str, dict[str, tuple[float, ...]]] = {
    "thrown/1": {
        "closing": (2.26, 2.56, 3.44, 3.66, 3.60),
        "reaction": (50.0, 66.5, 66.8, 66.9, 82.8),
        "command": (39.7, 61.5, 59.0, 60.7, 80.7),
        "avoid": (232.0, 283.0, 233.0, 233.0, 216.0),
        "detection": (3866.0, 3617.0, 2999.0, 3049.0, 2516.0),
        "separation": (0.205, 0.863, 0.393, 0.239, 0.695),
    },
    "moving/1": {
        "closing": (3.50, 3.74, 3.49, 3.36, 2.90),
        "reaction": (84.2, 84.0, 67.2, 82.9, 75.6),
        "command": (74.5, 71.6, 52.3, 70.3, 63.1),
        "avoid": (218.0, 241.0, 208.0, 225.0, 226.0),
        "detection": (2599.0, 2725.0, 2616.0, 2923.0, 2678.0),
        "separation": (0.312, 0.258, 0.446, 0.414, 0.324),
    },
    "both/1": {
        "closing": (1.99, 2.37, 2.86, 3.10, 1.43),
        "reaction": (82.8, 58.2, 59.1, 49.5, 58.1),
        "command": (56.0, 39.4, 34.7, 36.9, 40.5),
        "avoid": (233.0, 208.0, 184.0, 158.0, 116.0),
        "detection": (1884.0, 421.0, 342.0, 374.0, 375.0),
        "separation": (0.201, 0.486, 0.281, 0.390, 0.267),
    },
    "both/2": {
        "closing": (1.21, 1.25, 1.44, 1.74, 1.80),
        "reaction": (141.6, 80.6, 83.3, 92.3, 99.3),
        "command": (113.2, 62.1, 68.8, 68.5, 80.7),
        "avoid": (216.0, 214.0, 241.0, 200.0, 216.0),
        "detection": (5050.0, 5167.0, 3766.0, 3732.0, 3517.0),
        "separation": (0.657, 0.780, 0.550, 0.738, 0.702),
    },
}
# The same tables as printed: by obstacle and their mean; t_r, t_cm, t_cp [ms], v_cl [m/s], d_s [m]; of the
# hardware the means of five flights. Table II: (H_max, d_cl, t_hd) and s, v_cl, t_r, t_cm, t_cp, d_s.
DRACBF_PRINTED: dict[str, dict[str, dict[str, Any]]] = {
    "table-1": {
        name: {"s": s, "v_cl": v, "t_r": tr, "t_cm": tcm, "t_cp": tcp, "d_s": d, "std": std}
        for name, s, v, tr, tcm, tcp, d, std in (
            (
                "mpc",
                (99.52, 99.89, 99.71),
                (10.43, 10.97, 10.70),
                (10.14, 10.00, 10.07),
                (3.23, 3.21, 3.22),
                (0.956, 0.666),
                (2.82, 6.64, 4.73),
                (4.52, 0.93),
            ),
            (
                "cbf-qp",
                (99.51, 99.84, 99.67),
                (10.43, 11.00, 10.71),
                (10.03, 10.00, 10.02),
                (2.21, 2.19, 2.20),
                (0.714, 0.476),
                (2.82, 6.65, 4.74),
                (1.31, 0.46),
            ),
            (
                "rp-cbf",
                (99.52, 99.89, 99.71),
                (10.43, 10.97, 10.70),
                (106.26, 13.39, 59.83),
                (1.87, 2.26, 2.08),
                (0.642, 0.416),
                (2.82, 6.64, 4.73),
                (93.48, 0.48),
            ),
            (
                "dr-acbf",
                (99.48, 99.80, 99.64),
                (10.43, 10.98, 10.70),
                (10.06, 10.00, 10.03),
                (1.39, 1.41, 1.40),
                (0.444, 0.270),
                (2.82, 6.64, 4.73),
                (2.76, 0.38),
            ),
        )
    },
    "table-2": {
        name: {"set": setting, "values": values}
        for name, setting, values in (
            ("dr-acbf", (0.4, 3.0, 0.2), (82.5, 8.18, 12.74, 2.24, 0.475, 1.881)),
            ("h-max-0.2", (0.2, 3.0, 0.2), (79.8, 8.16, 11.88, 1.58, 0.312, 1.822)),
            ("h-max-0.8", (0.8, 3.0, 0.2), (82.5, 8.28, 12.35, 1.85, 0.382, 2.105)),
            ("clearance-1", (0.4, 1.0, 0.2), (82.3, 8.02, 12.87, 2.07, 0.234, 1.864)),
            ("clearance-4", (0.4, 4.0, 0.2), (77.6, 7.16, 12.16, 1.66, 0.423, 2.054)),
            ("hold-0.1", (0.4, 3.0, 0.1), (82.6, 7.10, 11.92, 1.72, 0.362, 1.924)),
            ("hold-0.4", (0.4, 3.0, 0.4), (82.6, 8.18, 12.17, 1.97, 0.403, 1.945)),
        )
    },
    "table-3": {
        "on": {
            "s": (80.0, 84.7, 82.5),
            "v_cl": (9.48, 7.10, 8.18),
            "t_r": (12.11, 12.95, 12.74),
            "t_cm": (2.11, 2.35, 2.24),
            "d_s": (2.969, 0.985, 1.881),
        },
        "off": {
            "s": (32.0, 37.9, 34.9),
            "v_cl": (9.70, 8.01, 8.70),
            "t_r": (11.74, 12.06, 11.93),
            "t_cm": (1.74, 2.06, 1.93),
            "d_s": (0.707, 0.858, 0.796),
        },
    },
    "hardware": {
        key: {
            "of": (words,),
            "closing": (v,),
            "reaction": (tr,),
            "command": (tcm,),
            "avoid": (ta,),
            "detection": (td,),
            "separation": (d,),
            "flights": _DRACBF_FLIGHTS[key],
        }
        for key, words, v, tr, tcm, ta, td, d in (
            ("thrown/1", "hovering, thrown object", 3.10, 66.6, 60.3, 239.0, 3209.0, 0.479),
            ("moving/1", "moving, thrown object", 3.40, 78.8, 66.4, 223.0, 2708.0, 0.351),
            ("both/1", "approaching UAV", 2.35, 61.5, 41.5, 180.0, 671.0, 0.325),
            ("both/2", "thrown object beside it", 1.49, 99.4, 78.7, 217.0, 4246.0, 0.685),
        )
    },
}
POLYMERGE_BYTES_PER_HALF_PLANE = 235

# Geofencing (arXiv 2201.04331), sections III-C, IV-D and V-C.
GEOFENCING: dict[str, dict[str, dict[str, float]]] = {
    "wall": {
        "simulation": {"peak_km_h": 107.0, "least_m": 0.12},
        "flight": {"peak_km_h": 104.0, "braking_m": 15.0, "tilt_deg": 90.0, "least_m": 1.7},
    },
    "fall": {
        "simulation": {"peak_km_h": 70.0, "rest_m": 1.2},
        "flight": {"peak_km_h": 60.0, "rest_m": 1.3},  # 1.8 m above the ground, the barrier is at 0.5 m
    },
    "pendulum": {"backup-qp": {"time_ratio": 10.0}},
    "filter": {"Teensy 4.1": {"tick_us": 350.0}},
}
