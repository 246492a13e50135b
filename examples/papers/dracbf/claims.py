"""Every table, figure, equation and printed number of DR-ACBF (arXiv 2512.00462)."""

from __future__ import annotations

from collections.abc import Iterable

from alula.stages.reporting.table import text
from papers.claims import Claim, Paper, pytest_of
from papers.dracbf.tables import SWEEP
from papers.published import DRACBF_PRINTED

_NAMES = {"mpc": "MPC", "cbf-qp": "CBF-QP", "rp-cbf": "RP-CBF", "dr-acbf": "DR-ACBF"}
_SYMBOLS = {
    "s": ("success rate", "%"),
    "v_cl": ("closing speed", "m/s"),
    "t_r": ("reaction time", "ms"),
    "t_cm": ("command time", "ms"),
    "d_s": ("minimum separation", "m"),
}
_EQUATIONS = "tests/unit/filtering/test_equations_dracbf.py"
_FLIGHTS = {
    "closing": ("v_cl", "closing speed", "m/s"),
    "reaction": ("t_r", "reaction time", "ms"),
    "command": ("t_cm", "command time", "ms"),
    "avoid": ("t_a", "avoid time", "ms"),
    "detection": ("t_d", "detection time", "ms"),
    "separation": ("d_s", "minimum separation", "m"),
}


def _values(values: Iterable[float], unit: str) -> str:
    return f"{', '.join(f'{value:g}' for value in values)} {unit}"


def _table_1() -> list[Claim]:
    found = []
    for key, name in _NAMES.items():
        printed = DRACBF_PRINTED["table-1"][key]
        for symbol, (words, unit) in _SYMBOLS.items():
            values = _values(printed[symbol], unit)
            if symbol in ("t_r", "t_cm"):
                values += f", standard deviation {text(printed['std'][symbol == 't_cm'])}"
            found.append(
                Claim(
                    f"table-1/{key}/{symbol}",
                    "Table I",
                    f"{words} of {name}: obstacles 1 and 2, mean",
                    values,
                    (f"Table I | {symbol}, {name},",),
                    "table",
                )
            )
        found.append(
            Claim(
                f"table-1/{key}/t_cp",
                "Table I",
                f"processing time of {name}, mean and standard deviation",
                _values(printed["t_cp"], "ms"),
                (f"Table I | t_cp, {name}",),
                "table",
            )
        )
    return found


def _table_2() -> list[Claim]:
    found = []
    symbols = (*_SYMBOLS.items(), ("t_cp", ("processing time", "ms")))
    order = ("s", "v_cl", "t_r", "t_cm", "t_cp", "d_s")
    for name in SWEEP:
        printed = DRACBF_PRINTED["table-2"][name]
        horizon, clearance, hold = (text(value) for value in printed["set"])
        words = f"H_max {horizon} s, d_cl {clearance} m, t_hd {hold} s"
        found += [
            Claim(
                f"table-2/{name}/{symbol}",
                "Table II",
                f"{meaning} with {words}",
                _values([printed["values"][order.index(symbol)]], unit),
                (f"Table II | {symbol}, {words}",),
                "table",
            )
            for symbol, (meaning, unit) in symbols
        ]
    return found


def _table_3() -> list[Claim]:
    return [
        Claim(
            f"table-3/{state}/{symbol}",
            "Table III",
            f"{words} with the DR-CVaR trigger {state}: obstacles 1 and 2, mean",
            _values(DRACBF_PRINTED["table-3"][state][symbol], unit),
            (f"Table III | {symbol}, DR-CVaR {state},",),
            "table",
        )
        for state in ("on", "off")
        for symbol, (words, unit) in _SYMBOLS.items()
    ]


def _hardware() -> list[Claim]:
    found = []
    for key, printed in DRACBF_PRINTED["hardware"].items():
        item = "Table IV" if key.split("/")[0] in ("thrown", "moving") else "Table V"
        for name, (symbol, meaning, unit) in _FLIGHTS.items():
            flights = ", ".join(text(value) for value in printed["flights"][name])
            found.append(
                Claim(
                    f"hardware/{key}/{symbol}",
                    item,
                    f"{meaning}, {printed['of'][0]}",
                    f"mean {text(printed[name][0])} {unit}; flights {flights}",
                    (f"{item} | {symbol}, {printed['of'][0]},",),
                    "table",
                )
            )
        found.append(
            Claim(
                f"hardware/{key}/safe",
                f"{item}, section V-B",
                f"every flight avoids the obstacle, {printed['of'][0]}",
                "5 of 5, d_s > R_sum = 0.2 m",
                (f"{item} | flights without collision, {printed['of'][0]}",),
                "table",
            )
        )
    return found


def _saved(name: str, where: str, against: str, printed: str, row: str) -> Claim:
    return Claim(name, where, f"computing time saved against {against}", printed, (row,))


DRACBF_PAPER = Paper(
    "dr-acbf",
    "Distributionally robust acceleration control barrier filter for efficient UAV obstacle avoidance",
    "arXiv 2512.00462",
    "Half-spaces of safe accelerations, a warning by the worst cases of uncertain tracks, and a projection "
    "instead of a quadratic program avoid moving obstacles as often as other filters, in less computing "
    "time.",
    "dracbf.md",
    (
        _saved(
            "saved-qp", "abstract, section I", "a QP with the same rows", "31 %", "abstract, section I | "
        ),
        Claim("saved-command", "section I", "command time saved", "over 32 %", ("section I | ",)),
        Claim(
            "figures-1-2",
            "Figures 1 and 2",
            "sketch of the half-spaces and block diagram",
            "",
            ("Figures 1 and 2 | ",),
            "figure",
            shows="A sketch of the half-spaces of safe accelerations, and the blocks of the system.",
        ),
        Claim(
            "invariance",
            "section III-A, (14) to (16)",
            "with k₁ = 2/H and k₂ = 2/H² the barrier does not decrease over the horizon",
            "k₁ = 2/H, k₂ = 2/H²",
            ("section III-A, (14) to (16) | ",),
            "theorem",
            pytest_of(f"{_EQUATIONS} -k complex_poles"),
        ),
        Claim(
            "risk-shares",
            "section III-B, (18) and (19)",
            "the risk is shared out by proximity and closing speed",
            "",
            ("(19) as printed | ",),
            "statement",
        ),
        Claim(
            "cantelli",
            "section III-B, (20) to (22)",
            "the safe set stays forward invariant with probability 1 − α_i",
            "",
            ("section III-B, (20) to (22) | ",),
            "theorem",
            pytest_of(f"{_EQUATIONS} -k tightening"),
        ),
        Claim(
            "envelope",
            "section III-C, (23) and (24)",
            "the envelope of an obstacle's acceleration grows to the largest estimate",
            "",
            ("(24) as printed | ", "section III-C | "),
            "statement",
        ),
        Claim(
            "trigger",
            "section III-D, (25) to (28)",
            "the DR-CVaR trigger warns before a violation is imminent",
            "",
            ("section III-D | ",),
            "statement",
            pytest_of("tests/unit/filtering/test_dr_acbf.py -k warning"),
        ),
        Claim(
            "southwell",
            "section III-E, (29) and (30)",
            "a fixed number of Gauss-Southwell iterations reaches the feasible set",
            "15 iterations, ω = 1.0",
            ("section III-E | ", "section IV-A | setting: iterations"),
            "statement",
            pytest_of("tests/unit/filtering/test_half_spaces.py -k southwell"),
        ),
        Claim(
            "as-printed",
            "all equations",
            "all equations as printed, together",
            "",
            ("all as printed | ",),
            "statement",
        ),
        Claim(
            "mpc-setting",
            "section IV",
            "settings of the MPC",
            "p = 20, m = 3",
            ("section IV | setting: MPC",),
            "setting",
        ),
        Claim(
            "rp-cbf-setting",
            "section IV",
            "settings of RP-CBF",
            "3.0 s, N = 32",
            ("section IV | setting: RP-CBF",),
            "setting",
        ),
        Claim(
            "cbf-qp-setting",
            "section IV",
            "horizon of CBF-QP",
            "0.4 s",
            ("section IV | setting: CBF-QP",),
            "setting",
        ),
        Claim(
            "radar",
            "section IV-A",
            "the radar",
            "80 × 20, 150 m",
            ("section IV-A | setting: field of view",),
            "setting",
        ),
        Claim(
            "vehicle",
            "section IV-A",
            "radii, limits and rate",
            "R_sum = 0.3 m, 6 m/s², 100 Hz, v_min = 5 m/s",
            ("section IV-A | setting: radii",),
            "setting",
        ),
        Claim(
            "scenario-1",
            "section IV-B",
            "scenario 1",
            "50 m, 3000 simulations",
            ("section IV-B | setting: scenario 1",),
            "setting",
        ),
        Claim(
            "scenario-2",
            "section IV-C",
            "scenario 2",
            "150 m and 200 m, 1000 runs",
            ("section IV-C | setting: scenario 2",),
            "setting",
        ),
        Claim(
            "settings",
            "section IV-A",
            "settings of the filter",
            "α_total 0.10, H 0.15 to 0.4 s, d_cl 1.0 m, t_hd 0.2 s, t_s 0.5 s, k_s 1.0",
            ("section IV-A | setting: risk budget",),
            "setting",
        ),
        Claim(
            "trigger-settings",
            "section IV-A",
            "settings of the trigger",
            "β 0.05, τ 0.02 s, ε 0.05",
            ("section IV-A | setting: β",),
            "setting",
        ),
        Claim(
            "differentiator",
            "section IV-A",
            "gains of the differentiator",
            "1.5, 4, 3",
            ("section IV-A | setting: gains of the sliding",),
            "setting",
        ),
        Claim(
            "directions",
            "section IV-A",
            "the best of 12 directions is flown",
            "12",
            ("section IV-A | setting: directions",),
            "setting",
        ),
        Claim(
            "tracker",
            "section IV-A",
            "obstacles are tracked by SAFE-IMM",
            "",
            ("section IV-A | SAFE-IMM",),
            "statement",
        ),
        _saved(
            "saved-rp-cbf", "section IV-B", "RP-CBF", "31 %", "section IV-B | computing saved against RP-CBF"
        ),
        _saved(
            "saved-cbf-qp",
            "section IV-B",
            "CBF-QP",
            "31 to 54 %",
            "section IV-B | computing saved against CBF-QP",
        ),
        _saved("saved-mpc", "section IV-B", "MPC", "54 %", "section IV-B | computing saved against MPC"),
        *_table_1(),
        *_table_2(),
        Claim(
            "difficulty",
            "Table II",
            "in scenario 2 the success is far from 100 %",
            "82.5 %",
            ("Table II | difficulty at which",),
            "table",
        ),
        Claim(
            "every-configuration",
            "section IV-C",
            "the success stays above 77 % in every configuration",
            "77 %",
            ("section IV-C | s in every configuration",),
        ),
        Claim(
            "steady-reaction",
            "section IV-C",
            "the reaction time does not change significantly over the configurations",
            "11.88 to 12.87 ms",
            ("section IV-C | t_r over the settings",),
        ),
        Claim(
            "steady-separation",
            "section IV-C",
            "the separation does not change significantly over the configurations",
            "1.822 to 2.105 m",
            ("section IV-C | d_s over the settings",),
        ),
        *_table_3(),
        Claim(
            "collapse",
            "section IV-C, Table III",
            "without the DR-CVaR trigger the success collapses",
            "82.5 to 34.9 %",
            ("Table III | the success of DR-CVaR collapses",),
            "table",
        ),
        Claim(
            "longer-horizons",
            "section IV-C",
            "without the trigger longer horizons raise the success",
            "",
            ("section IV-C | longer horizons",),
            "statement",
        ),
        Claim(
            "projection-success",
            "section IV-C",
            "projection and QP succeed equally often",
            "similar",
            ("section IV-C | success with projection",),
            "statement",
        ),
        Claim(
            "projection-time",
            "section IV-C",
            "the projection takes less processing time than the QP",
            "0.475 and 0.766 ms",
            ("section IV-C | computing saved by the projection",),
        ),
        Claim(
            "projection-command",
            "section IV-C",
            "the projection takes less command time than the QP",
            "2.24 and 5.36 ms",
            ("section IV-C | t_cm with projection",),
        ),
        Claim(
            "hardware-setup",
            "section V-A",
            "motion capture and area of the flights",
            "120 Hz, 2 m × 3 m, 100 Hz",
            ("section V-A | tracking",),
            "setting",
        ),
        Claim(
            "crazyflie",
            "section V-A",
            "settings of the flights of the Crazyflie",
            "0.8 m/s², R 0.10 m, d_cl 0.05 m, t_hd 0.2 s, t_s ≤ 0.7 s, k_s 0.2",
            ("section V-A | setting: radii",),
            "setting",
        ),
        *_hardware(),
    ),
)
