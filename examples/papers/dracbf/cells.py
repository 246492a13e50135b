"""The claims of DR-ACBF's Tables I to V, made cell by cell from the numbers that they print."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from alula.stages.reporting.table import text
from papers.claims import Claim, Row
from papers.published import DRACBF_PRINTED

NAMES = {"mpc": "MPC", "cbf-qp": "CBF-QP", "rp-cbf": "RP-CBF", "dr-acbf": "DR-ACBF"}
HARDWARE = "flights of a Crazyflie; ours is its simulated counterpart"
_SYMBOLS = {  # of Tables I to III
    "s": ("success rate", "%"),
    "v_cl": ("closing speed", "m/s"),
    "t_r": ("reaction time", "ms"),
    "t_cm": ("command time", "ms"),
    "d_s": ("minimum separation", "m"),
    "t_cp": ("processing time", "ms"),
}
_OF_TABLE_2 = ("s", "v_cl", "t_r", "t_cm", "t_cp", "d_s")  # the order of its values
_OF_FLIGHTS = {  # of Tables IV and V
    "closing": ("v_cl", "closing speed", "m/s"),
    "reaction": ("t_r", "reaction time", "ms"),
    "command": ("t_cm", "command time", "ms"),
    "avoid": ("t_a", "avoid time", "ms"),
    "detection": ("t_d", "detection time", "ms"),
    "separation": ("d_s", "minimum separation", "m"),
}
_TIMES = "MATLAB on a laptop there, C here: only ratios compare"
_COURSES = "the paper leaves out the speeds and courses that decide it; those here are our choice"
_WHY: dict[str, str | dict[str, str]] = {
    "s": {
        "not comparable": "the paper leaves out what lowers it (noise, missed detections, delays); see the "
        "table on difficulty",
        "refuted": "lower than published, with our speeds, noise and courses",
    },
    "v_cl": {"not comparable": _COURSES},
    "d_s": {"not comparable": _COURSES},
    "t_r": {
        "reproduced": "one tick; the rest of the published value is its computing time",
        "bounded": "within a tick",
        "refuted": "the first command after the warning differs, one tick later, as for the others",
    },
    "t_cm": _TIMES,
    "t_cp": _TIMES,
}


def _row(symbol: str, name: str, item: str, of: str, published: float) -> Row:
    unit = _SYMBOLS[symbol][1]
    return Row(
        name=name,
        item=item,
        quantity=f"{symbol}, {of}",
        published=f"{published:g} {unit}",
        ours=f"{{value}} {unit}",
        interval=f"{{low}} to {{high}} {unit}",
        why=_WHY[symbol],
        limits=[published],
    )


def _rows(symbol: str, item: str, of: str, printed: Iterable[float]) -> list[Row]:
    """Rows of the values that Tables I and III print for each of the two obstacles, and for their mean."""
    names = {"1": "obstacle 1", "2": "obstacle 2", "mean": "mean"}
    values = zip(names.items(), printed, strict=True)
    return [_row(symbol, name, item, f"{of}, {words}", value) for (name, words), value in values]


def _values(values: Iterable[float], unit: str) -> str:
    return f"{', '.join(f'{value:g}' for value in values)} {unit}"


def _spread(symbol: str, method: str, std: float) -> Row:
    """Row of a standard deviation in Table I."""
    words = {
        "t_r": (
            "{value} ms",
            "theirs has the computing time in MATLAB, ours is in whole ticks; extreme outliers are removed "
            "there",
        ),
        "t_cm": ("", "only the mean of a run's command times is kept"),
    }
    ours, why = words[symbol]
    quantity = f"{symbol}, {method}, standard deviation"
    published = f"{text(std)} ms"
    return Row(name="spread", item="Table I", quantity=quantity, published=published, ours=ours, why=why)


def _table_1() -> list[Claim]:
    found = []
    for key, method in NAMES.items():
        printed = DRACBF_PRINTED["table-1"][key]
        for symbol, (words, unit) in _SYMBOLS.items():
            says, values = f"{words} of {method}: obstacles 1 and 2, mean", _values(printed[symbol], unit)
            if symbol == "t_cp":
                says = f"{words} of {method}, mean and standard deviation"
                mean, std = map(text, printed[symbol])
                cell = {"published": f"{mean} ± {std} ms", "ours": "{value} ± {std} ms", "why": _TIMES}
                rows = [Row(item="Table I", quantity=f"t_cp, {method}", **cell)]  # type: ignore[arg-type]
            else:
                rows = _rows(symbol, "Table I", method, printed[symbol])
            if symbol in ("t_r", "t_cm"):
                std = printed["std"][symbol == "t_cm"]
                values += f", standard deviation {text(std)}"
                rows.append(_spread(symbol, method, std))
            found.append(_claim(f"table-1/{key}/{symbol}", "Table I", says, values, rows))
    return found


def _claim(name: str, where: str, says: str, printed: str, rows: list[Row]) -> Claim:
    return Claim(name=name, where=where, says=says, printed=printed, rows=rows, kind="table")


def _table_2() -> list[Claim]:
    found = []
    for name, printed in DRACBF_PRINTED["table-2"].items():
        horizon, clearance, hold = (text(value) for value in printed["set"])
        words = f"H_max {horizon} s, d_cl {clearance} m, t_hd {hold} s"
        for symbol, (meaning, unit) in _SYMBOLS.items():
            value = printed["values"][_OF_TABLE_2.index(symbol)]
            rows = [_row(symbol, "", "Table II", words, value)]
            where = f"table-2/{name}/{symbol}"
            found.append(_claim(where, "Table II", f"{meaning} with {words}", _values([value], unit), rows))
    return found


def _table_3() -> list[Claim]:
    return [
        _claim(
            f"table-3/{state}/{symbol}",
            "Table III",
            f"{words} with the DR-CVaR trigger {state}: obstacles 1 and 2, mean",
            _values(DRACBF_PRINTED["table-3"][state][symbol], unit),
            _rows(symbol, "Table III", f"DR-CVaR {state}", DRACBF_PRINTED["table-3"][state][symbol]),
        )
        for state in ("on", "off")
        for symbol, (words, unit) in _SYMBOLS.items()
        if symbol != "t_cp"
    ]


def _hardware() -> list[Claim]:
    found = []
    for key, printed in DRACBF_PRINTED["hardware"].items():
        item = "Table IV" if key.split("/")[0] in ("thrown", "moving") else "Table V"
        of = printed["of"][0]
        for name, (symbol, meaning, unit) in _OF_FLIGHTS.items():
            each = ", ".join(text(value) for value in printed["flights"][name])
            mean = text(printed[name][0])
            is_measured = name not in ("reaction", "command")
            cell: dict[str, Any] = {
                "published": f"{mean} {unit} ({each})",
                "why": HARDWARE if is_measured else "includes the radio, a Python bridge and the vehicle",
            }
            if is_measured:
                cell |= {"ours": f"{{value}} {unit}", "interval": f"{{low}} to {{high}} {unit}"}
            else:
                cell["verdict"] = "not available here"
            row = Row(item=item, quantity=f"{symbol}, {of}, mean of five flights", **cell)
            says, values = f"{meaning}, {of}", f"mean {mean} {unit}; flights {each}"
            found.append(_claim(f"hardware/{key}/{symbol}", item, says, values, [row]))
        safe = Row(
            item=item,
            quantity=f"flights without collision, {of}",
            published="5 of 5 (Wilson 57 to 100 %); d_s always above 0.2 m",
            ours="{value} %",
            interval="{low} to {high} %",
            why="simulated with the printed d_cl of 0.05 m; the tables of the page have our own settings too",
            limits=[56.6],
        )
        says, where = f"every flight avoids the obstacle, {of}", f"{item}, section V-B"
        found.append(_claim(f"hardware/{key}/safe", where, says, "5 of 5, d_s > R_sum = 0.2 m", [safe]))
    return found


DRACBF_TABLES = {
    "table-1": _table_1(),
    "table-2": _table_2(),
    "table-3": _table_3(),
    "hardware": _hardware(),
}
