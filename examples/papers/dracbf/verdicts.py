"""Every published value of DR-ACBF, ours beside it, and a verdict.

Success and separation come from the runs of the example. Fractions of computing time come from replaying the
same ticks through all filters in turns (`benchmarks/dracbf.py --ticks-only`): absolute times of MATLAB on a
laptop compare with nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from alula import _core
from alula.stages.reporting.table import HIGH, LOW, Table, text
from papers.compared import VERDICTS
from papers.dracbf.analysis import stop
from papers.dracbf.difficulty import paired
from papers.dracbf.flown import flown_settings
from papers.dracbf.rows import MATLAB, NAMES, command_time, made_of, missing, span
from papers.dracbf.table_verdicts import hardware, table_1, table_2, table_3
from papers.dracbf.tables import (
    BASE,
    Flown,
    find,
    success,
)
from papers.settings import settings_rows
from papers.verdicts import PaperRow, exact

Times = Mapping[str, Any]

_TIMED = {
    "tick": "dr-acbf, exact projection",
    "general_qp_tick": "the same rows, our QP solver",
    "general_qp_quadprog_tick": "the same rows, quadprog",
    "general_qp_clarabel_tick": "the same rows, Clarabel",
    "mpc_tick": "mpc",
    "cbf_qp_tick": "cbf-qp",
    "rp_cbf_tick": "rp-cbf",
}


def verdict_rows(flown: Sequence[Flown], times: Times) -> list[PaperRow]:
    """Make all rows, in the paper's order.

    Args:
        flown: runs of the example; rows of runs that are missing say so.
        times: what `benchmarks/dracbf.py --ticks-only` measured; may be empty.
    """
    return [
        *settings_rows("dr-acbf"),
        *flown_settings(flown),
        *_claims(flown, times),
        *_equations(flown),
        *table_1(flown),
        *table_2(flown),
        *table_3(flown),
        *_projection(flown, times),
        *hardware(flown),
    ]


def counted(rows: Sequence[PaperRow]) -> dict[str, str]:
    """Summarise the verdicts: how many of each, and what is refuted."""
    words = ", ".join(f"{sum(row.verdict == name for row in rows)} {name}" for name in VERDICTS)
    refuted = [
        f"{row.quantity} ({row.published}; ours {row.ours})" for row in rows if row.verdict == "refuted"
    ]
    return {"published values": f"{len(rows)} rows: {words}"} | (
        {"refuted": "; ".join(refuted)} if refuted else {}
    )


def saving_table(times: Times) -> Table | None:
    """Tabulate the times of all filters in the same ticks, and what `dr-acbf` saves; None without times."""
    saved = times.get("saved")
    if not saved:
        return None
    rows = []
    for key, name in _TIMED.items():
        if f"{key}_mean_us" not in times:
            continue
        fraction = [saved[key][k] if key in saved else None for k in ("value", "low", "high")]
        rows.append(
            (
                name,
                *(times[f"{key}_{of}_us"] for of in ("mean", "p50", "p99")),
                *(None if x is None else 100 * x for x in fraction),
            )
        )
    columns = ("filter", "mean [µs]", "p50 [µs]", "p99 [µs]", "saved by dr-acbf [%]", LOW, HIGH)
    note = (
        f"{times['active_ticks']:,} active ticks of scenario 1, the same for all, each timed on copies of "
        "the filter, trial by trial in turns. Saved: medians of trials, bootstrap interval over trials. "
        "Published: 31 % against RP-CBF, 38 % against CBF-QP, 54 % against MPC and, in scenario 2, 38 % "
        "against a QP with the same rows (31 % in the abstract)."
    )
    return Table("saved", "Computing time in the same ticks", columns, tuple(rows), note)


def _claims(flown: Sequence[Flown], times: Times) -> list[PaperRow]:
    saved = times.get("saved", {})
    rows = [
        _saved(
            "abstract, section I",
            "computing saved against a QP with the same rows (t_cp)",
            0.31,
            saved.get("general_qp_tick"),
        )
    ]
    rows += [
        _saved("section IV-B", f"computing saved against {NAMES[name]} (t_cp)", published, saved.get(key))
        for name, key, published in (
            ("rp-cbf", "rp_cbf_tick", 1 - 0.444 / 0.642),
            ("cbf-qp", "cbf_qp_tick", 1 - 0.444 / 0.714),
            ("mpc", "mpc_tick", 1 - 0.444 / 0.956),
        )
    ]
    base = find(flown, "scenario-1", BASE)
    others = [f for name in ("mpc", "cbf-qp", "rp-cbf") if (f := find(flown, "scenario-1", name)) is not None]
    if base is not None and others:
        mine = command_time(base)
        ratios = [(f.variant, command_time(f)) for f in others]
        words = ", ".join(
            f"{name} {exact(100 * (1 - mine / other))} %" for name, other in ratios if mine and other
        )
        rows.append(
            made_of(
                PaperRow(
                    *("section I", "command time saved (t_cm)", "over 32 %", words, ""),
                    "not comparable",
                    "each warning is one tick, timed once while other programs run; the replay of ticks "
                    "above is the fair comparison",
                ),
                base,
                *others,
            )
        )
    rows.append(
        PaperRow(
            *("Figures 1 and 2", "sketch and block diagram", "no values", "", "", "not comparable"),
            "nothing to measure; every block is flown here",
        )
    )
    return rows


def _saved(item: str, quantity: str, published: float, found: Mapping[str, Any] | None) -> PaperRow:
    """Judge a fraction of computing time saved: refuted when the interval lies below the published one."""
    printed = f"{100 * published:.0f} %"
    if found is None or found["value"] is None:
        return missing(item, quantity, printed)
    value, low, high = (None if found[k] is None else 100 * found[k] for k in ("value", "low", "high"))
    assert value is not None
    if low is None or high is None:
        verdict, why = "not comparable", "too few trials for an interval"
    elif high < 100 * published - 0.5:
        verdict, why = "refuted", "same ticks, same warning and manoeuvre, in turns, one process"
    elif low > 100 * published + 0.5:
        verdict, why = "better", "we save more: our warning, which all filters share, costs less"
    else:
        verdict, why = "reproduced", "same ticks, same warning and manoeuvre, in turns, one process"
    return PaperRow(
        item, quantity, printed, f"{exact(value)} %", span(low, high, " %"), verdict, why
    ).made_from(["times.json"])


def _equations(flown: Sequence[Flown]) -> list[PaperRow]:
    horizon = 0.4
    limit = _core.recursive_speed(6.0, horizon)
    undershoot = stop(limit, horizon).undershoot_m
    fast = stop(8.0, horizon, 6.0).undershoot_m
    rows = [
        PaperRow(
            *("section III-A, (14) to (16)", "the barrier value does not decrease over H", "holds"),
            f"falls by {exact(100 * undershoot / (limit * horizon))} % of v₀ H below 0 with the row followed "
            f"exactly; by {exact(fast)} m from 8 m/s with |a| at most 6 m/s²",
            *("exact", "refuted"),
            "k₁ = 2/H and k₂ = 2/H² have complex poles; test_the_printed_gains_have_complex_poles",
        ),
        PaperRow(
            *("section III-B, (20) to (22)", "the safe set stays forward invariant with 1 − α_i", "holds"),
            "holds for one row and tick if the track's covariance is honest; budgets of ticks add up",
            *("", "bounded"),
            "Cantelli's inequality concerns one prediction; the risk table has whole flights",
        ),
        PaperRow(
            *("section III-C", "the differentiator estimates an obstacle's acceleration in finite time"),
            *("(23)", "equals (23), stepped at the rate of the tracks", "", "reproduced"),
            "test_the_envelope_is_the_sliding_mode_differentiator",
        ),
        PaperRow(
            *("section III-D", "the warning comes before a violation is imminent", "(25) to (28)"),
            *("never below the CVaR of 8,000 samples; at the printed distance without noise", ""),
            *("reproduced", "a closed form that is rounded up instead of N_s samples, which are not printed"),
        ),
        PaperRow(
            *("section III-E", "the iteration reaches the feasible set", "15 iterations"),
            *("a feasible point where it converges; it need not within 15 iterations", "", "bounded"),
            "rows and faces of the box may meet at acute angles; the exact projection always ends",
        ),
    ]
    base = {s: find(flown, s, BASE) for s in ("scenario-1", "scenario-2")}
    for item, name, quantity in (
        ("(19) as printed", "eq-19", "risk shared with receding and distant obstacles: success of runs"),
        ("(24) as printed", "eq-24", "envelope without forgetting and cap: success of runs"),
        ("section IV-A", "safe-imm-on", "SAFE-IMM on instead of a standard IMM: success of runs"),
        (
            "all as printed",
            "all-as-printed",
            "with Gauss-Southwell, rows only in a manoeuvre: success of runs",
        ),
    ):
        for scenario, reference in base.items():
            f = find(flown, scenario, name)
            if f is None or reference is None:
                rows.append(missing(item, f"{quantity}, {scenario}", ""))
                continue
            now, gap = success(f), paired(f, reference)
            words = (
                ""
                if gap is None
                else f"{text(gap.value)} points against ours ({span(gap.low, gap.high)}), paired"
            )
            published = "99.64 %" if scenario == "scenario-1" else "82.5 %"
            verdict = (
                "reproduced"
                if scenario == "scenario-1" and now.ends[1] >= 99.64 >= now.ends[0]
                else "bounded"
            )
            if (now.value or 0.0) < 77.6:
                verdict = "refuted"
            rows.append(
                made_of(
                    PaperRow(
                        *(item, f"{quantity}, {scenario}", published, f"{exact(now.value)} %"),
                        *(span(now.low, now.high, " %"), verdict, words),
                    ),
                    f,
                    reference,
                )
            )
    return rows


def _projection(flown: Sequence[Flown], times: Times) -> list[PaperRow]:
    saved = times.get("saved", {}).get("general_qp_tick")
    rows = [
        _saved(
            "section IV-C",
            "computing saved by the projection against the QP, scenario 2 (t_cp 0.475 and 0.766 ms)",
            1 - 0.475 / 0.766,
            saved,
        )
    ]
    rows.append(
        PaperRow(
            *("section IV-C", "t_cm with projection and with QP", "2.24 and 5.36 ms", "", ""),
            *("not comparable", MATLAB),
        )
    )
    ours, other = (find(flown, "scenario-2", name) for name in ("dr-acbf-gs", "dr-acbf-qp"))
    gap = None if ours is None or other is None else paired(ours, other)
    if gap is not None and gap.low is not None and gap.high is not None:
        similar = gap.low <= 0 <= gap.high
        rows.append(
            made_of(
                PaperRow(
                    *("section IV-C", "success with projection and with QP", "similar"),
                    *(f"{exact(gap.value)} points apart", span(gap.low, gap.high)),
                    *("reproduced" if similar else "refuted", "paired trials of scenario 2"),
                ),
                *(ours, other),
            )
        )
    return rows
