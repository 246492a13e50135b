"""One self-contained HTML page: verdict, picture and numbers; playback; guarantees; figures; folded tables.

Every number that the page rounds stands beside its value with all digits, in the element's `value` (`<data>`)
or, in tables, its `data-value`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

from alula.stages.reporting.brief import Brief, Number, Subject, brief
from alula.stages.reporting.content import Content
from alula.stages.reporting.differences import difference_words
from alula.stages.reporting.figures import STILL, Figure
from alula.stages.reporting.flight_figures import NAME as FLIGHT
from alula.stages.reporting.guarantees import GUARANTEES
from alula.stages.reporting.headline import chain
from alula.stages.reporting.material import Material
from alula.stages.reporting.palette import run_color, themed
from alula.stages.reporting.style import STYLE, SWITCH
from alula.stages.reporting.table import Table, folded, text

_DENSE_COLUMNS = 10  # wider tables get narrower cells
_OPEN_ROWS = 15  # longer tables are folded on pages without a verdict, too; shorter ones are their subject
_NUMBERS = 4  # of a run on the first screen
_RUNS_AS_COLUMNS = 3  # more runs are rows

_FOLLOW = files("alula.stages.reporting").joinpath("follow.js").read_text(encoding="utf-8")

# It blocks every request of a page; the code, workers and data of a 3D view are inside the page.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "script-src 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src blob: data:; connect-src data: blob:"
)


@dataclass(frozen=True, slots=True)
class View:
    """A page that shows the scene in 3D, and a note on what it leaves out."""

    html: str
    note: str


def page(
    material: Material,
    tables: Sequence[Table],
    figures: Sequence[Figure],
    view: View | None,
    provenance_line: str = "",
    facts: Mapping[str, str] | None = None,
    *,
    picture: Figure | None = None,
    flights: Sequence[Figure] = (),
    differences: Sequence[Table] = (),
) -> str:
    """Write the page; it loads nothing from elsewhere, and every name in it is escaped.

    Args:
        tables: in reading order; all are folded.
        view: the 3D view, shown in a sandboxed frame.
        provenance_line: put into the head, where `read_provenance` finds it.
        facts: summary lines by subject, of a page about no run and no map.
        picture: still picture of the first screen.
        flights: figures of single flights over time, shown beside the 3D view.
        differences: tables that compare runs, shown above the guarantees.
    """
    found = brief(material)
    parts = [
        _hero(found, picture),
        _in_short(facts or {}),
        *[_difference(table, is_open=len(differences) == 1) for table in differences],
        _playback(view, flights),
        f"<script>{_FOLLOW}</script>" if view is not None and any(one.time for one in flights) else "",
        _apart(material, found),
        _guarantees(found),
    ]
    if figures:
        parts += ["<h2>Figures</h2>", '<div class="figures">', *map(figure_html, figures), "</div>"]
    if tables:
        parts += [
            "<h2>Tables</h2>",
            *[
                _table(table, is_open=not found.subjects and len(table.rows) <= _OPEN_ROWS)
                for table in tables
            ],
        ]
    parts.append(_provenance(material))
    return document(material.title, _subtitle(material), parts, provenance_line=provenance_line)


def document(
    title: str,
    subtitle: str,
    parts: Iterable[str],
    *,
    style: str = "",
    policy: str = POLICY,
    head: str = "",
    provenance_line: str = "",
) -> str:
    """Write a page in the style of reports around its parts; the empty ones are left out.

    Args:
        parts: HTML, in reading order.
        style: style sheet in addition to that of reports.
        policy: what the page may load.
        head: further elements of the head.
        provenance_line: put into the head, where `read_provenance` finds it.
    """
    lines = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<!-- {comment(provenance_line)} -->" if provenance_line else "",
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        head,
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}{style}</style></head><body><main>",
        f'<header><h1>{escape(title)}</h1><p class="soft">{escape(subtitle)}</p>'
        f'<label class="switch"><input type="checkbox" id="{SWITCH}">dark / light</label></header>',
        *parts,
        "</main></body></html>",
    ]
    return "\n".join(line for line in lines if line) + "\n"


def report_page(
    material: Material, content: Content, figures: Sequence[Figure], view: View | None, line: str
) -> str:
    """Write the page of a report."""
    picture = next((figure for figure in figures if figure.name == STILL), None)
    flights = [figure for figure in figures if figure.name.startswith(FLIGHT)]
    others = [figure for figure in figures if figure is not picture and figure not in flights]
    return page(
        material, content.tables, others, view, line,
        picture=picture, flights=flights, differences=content.differences,
    )  # fmt: skip


def comment(line: str) -> str:
    """Escape JSON text for an HTML comment: JSON's own escapes hide the characters that would end it."""
    return line.replace("--", "-\\u002d").replace(">", "\\u003e").replace("<", "\\u003c")


def _subtitle(material: Material) -> str:
    trials = sum(len(run.record.trials) for run in material.runs)
    parts = []
    if material.runs:
        unjudged = sum(not run.record.trials for run in material.runs)
        counts = [f"{text(trials)} {'flight' if trials == 1 else 'flights'}"] if trials else []
        counts += [f"{unjudged} not judged"] if unjudged else []
        runs = f" in {len(material.runs)} runs" if len(material.runs) > 1 else ""
        parts.append(f"{', '.join(counts)}{runs}")
        filters = dict.fromkeys(run.record.filter for run in material.runs)
        parts.append(f"filter {', '.join(filters)}")
        if len(vehicles := list(dict.fromkeys(run.record.vehicle for run in material.runs))) == 1:
            parts.append(vehicles[0])
    if material.cover is not None:
        parts.append(f"voxels of {text(material.cover.manifest.voxel_size_m)} m")  # type: ignore[attr-defined]
    return " · ".join(parts)


def _hero(found: Brief, picture: Figure | None) -> str:
    """The first screen: verdict and numbers beside the picture."""
    runs = found.of_kind("run")
    if not found.subjects:
        return ""
    said = [f'<p class="verdict {found.tone}">{escape(found.verdict)}</p>' if found.verdict else ""]
    if len(runs) > 1:
        said.append(_board(runs))
    else:
        said.append(_numbers(found.subjects[0]))
    still = ""
    if picture is not None:
        still = f"<figure>{inline_svg(picture)}<figcaption>{escape(picture.alt)}</figcaption></figure>"
    alone = "" if still else " alone"
    return f'<section class="hero{alone}"><div class="say">{"".join(said)}</div>{still}</section>'


def _numbers(subject: Subject) -> str:
    items = "".join(
        f"<div><dt>{escape(number.label)}</dt>"
        f'<dd class="big {_tone(number)}">{_data(number, subject)}</dd>'
        + (f'<dd class="more">{escape(number.detail)}</dd>' if number.detail else "")
        + "</div>"
        for number in subject.numbers
    )
    return f'<dl class="numbers">{items}</dl>' if items else ""


def _tone(number: Number) -> str:
    return "" if number.good is None else "good mark" if number.good else "bad mark"


def _data(number: Number, subject: Subject) -> str:
    """The number as it is read, with the value that it stands for."""
    return (
        f'<data value="{escape(_exact(number.value))}" data-of="{escape(subject.title)}" '
        f'data-key="{number.key}">{escape(number.shown)}</data>'
    )


def _exact(value: Any) -> str:
    """JSON of a value; of a float that is not finite nothing."""
    if isinstance(value, float) and not math.isfinite(value):
        return ""
    if isinstance(value, np.generic):
        return _exact(value.item())
    return json.dumps(value, ensure_ascii=False)


def _board(runs: Sequence[Subject]) -> str:
    """Runs side by side, each in its colour, with the same numbers: a column for each, or many as rows."""
    keys: dict[str, str] = {}
    for subject in runs:
        for number in subject.numbers:
            keys.setdefault(number.key, number.label)
    if len(keys) > _NUMBERS:
        keys = {key: label for key, label in keys.items() if sum(_has(s, key) for s in runs) > 1}
    names = [
        f"{_dot(place)}{escape(subject.title)}<span>{escape(subject.words.split(' · ')[0])}</span>"
        for place, subject in enumerate(runs)
    ]
    if len(runs) <= _RUNS_AS_COLUMNS:
        heads = ["", *names]
        rows = [[escape(label), *(_cell(subject, key) for subject in runs)] for key, label in keys.items()]
    else:
        heads = ["", *map(escape, keys.values())]
        rows = [
            [name, *(_cell(subject, key) for key in keys)] for name, subject in zip(names, runs, strict=True)
        ]
    head = "".join(f'<th scope="col">{words}</th>' for words in heads)
    body = "".join(f'<tr><th scope="row">{row[0]}</th>{"".join(row[1:])}</tr>' for row in rows)
    many = "" if len(runs) <= _RUNS_AS_COLUMNS else " many"
    return (
        f'<div class="scroll"><table class="board{many}"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(subject: Subject, key: str) -> str:
    for number in subject.numbers:
        if number.key == key:
            return f'<td class="{_tone(number)}"><b>{_data(number, subject)}</b></td>'
    return "<td>–</td>"


def _has(subject: Subject, key: str) -> bool:
    return any(number.key == key for number in subject.numbers)


def _dot(place: int) -> str:
    return f'<i class="dot" style="background: var(--c{run_color(place)[1:]})"></i>'


def _playback(view: View | None, flights: Sequence[Figure]) -> str:
    parts = []
    if view is not None:
        parts.append(_view(view))
    elif flights:
        parts.append("<h2>The flight over time</h2>")
    parts += [figure_html(figure, name="flight") for figure in flights]
    return "".join(parts)


def _view(view: View) -> str:
    note = f"{view.note} Drag to turn, scroll to zoom. Without WebGL the view is a picture."
    return (
        '<h2>Look around</h2><iframe title="3D view of scene, map and flights" '
        f'sandbox="allow-scripts" loading="lazy" srcdoc="{escape(view.html)}"></iframe>'
        f'<p class="soft">{escape(note.strip())}</p>'
    )


def _apart(material: Material, found: Brief) -> str:
    """Sections on the map and the plan, where the first screen does not show their numbers."""
    parts = []
    shown = found.subjects[:1] if not found.of_kind("run") else ()
    for subject in (*found.of_kind("map"), *found.of_kind("plan")):
        numbers = "" if subject in shown else _numbers(subject)
        links = _chain(material) if subject.kind == "map" else ""
        if numbers:
            verdict = f"<p>{escape(subject.verdict)}</p>"
            parts.append(
                f'<h2>{escape(subject.title)}</h2><div class="panel apart">{verdict}{numbers}</div>{links}'
            )
        elif links:
            parts.append(f"<h2>{escape(subject.title)}</h2>{links}")
    return "".join(parts)


def _chain(material: Material) -> str:
    links = [
        f"<div><b>{escape(count)}</b><span>{escape(what)}</span></div>" for count, what in chain(material)
    ]
    return f'<div class="panel chain">{"<i>→</i>".join(links)}</div>' if links else ""


def _guarantees(found: Brief) -> str:
    items = [f'<li class="yes">{escape(line)}</li>' for line in found.proofs]
    items += [f'<li class="no">{escape(line)}</li>' for line in found.limits]
    if not (items or found.statements):
        return ""
    plain = f'<ul class="panel promise">{"".join(items)}</ul>' if items else ""
    exact = _lines(found.statements)
    folded = f"<details><summary>The exact statements</summary>{exact}</details>" if exact else ""
    return f"<h2>{GUARANTEES}</h2>{plain}{folded}"


def _in_short(facts: Mapping[str, str]) -> str:
    lines = _lines(facts.items())
    return f"<h2>In short</h2>{lines}" if lines else ""


def _lines(statements: Iterable[tuple[str, str]]) -> str:
    return "".join(f"<p><b>{escape(subject)}:</b> {escape(line)}</p>" for subject, line in statements if line)


def figure_html(figure: Figure, *, name: str = "") -> str:
    """A figure with title and caption as a part of a page; `name` is a class of the style sheet."""
    names = " ".join(word for word in ("wide" if figure.wide else "", name) if word)
    kind = f' class="{names}"' if names else ""
    if figure.time is not None:
        kind += f' data-time="{escape(json.dumps(asdict(figure.time), ensure_ascii=False))}"'
    return (
        f'<figure id="{escape(figure.name)}"{kind}><h3>{escape(figure.title)}</h3>'
        f"{inline_svg(figure)}<figcaption>{escape(figure.alt)}</figcaption></figure>"
    )


_SIZE = re.compile(r' (?:width|height)="[^"]*"')
_IDS = re.compile(r'(\bid="|xlink:href="#|url\(#)')
_STYLE_SHEET = re.compile(r"<style[^>]*>.*?</style>", re.DOTALL)
_ABOUT = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)


def inline_svg(figure: Figure) -> str:
    """An SVG as part of the page: in the page's colours, as wide as its place, with ids of its own."""
    whole = figure.svg[figure.svg.index("<svg") :]
    whole = _ABOUT.sub("", _STYLE_SHEET.sub("", whole, count=1), count=1)
    head, rest = whole.split(">", 1)
    head = _SIZE.sub("", head)
    label = f' role="img" aria-label="{escape(figure.alt)}"'
    own = _IDS.sub(lambda found: f"{found[1]}{figure.name}-", themed(rest))
    return f'<div class="svg">{head}{label}>{own}</div>'


def _difference(table: Table, *, is_open: bool) -> str:
    """A comparison of two runs: in words, and as a table, which is folded where there are several."""
    said = "".join(f"<li>{escape(line)}</li>" for line in difference_words(table))
    said = f'<ul class="panel said">{said}</ul>' if said else ""
    note = f'<p class="soft">{escape(table.note)}</p>' if table.note else ""
    rows = _rows(folded(table))
    if is_open:
        shown = f'<div class="panel scroll">{rows}</div>{note}'
    else:
        shown = f'<details><summary>All differences</summary><div class="scroll">{rows}</div>{note}</details>'
    return f'<section id="{escape(table.name)}"><h2>{escape(table.title)}</h2>{said}{shown}</section>'


def _table(table: Table, *, is_open: bool) -> str:
    note = f'<p class="soft">{escape(table.note)}</p>' if table.note else ""
    width = " narrow" if len(table.columns) <= 4 else " dense" if len(table.columns) > _DENSE_COLUMNS else ""
    count = f"{len(table.rows):,} {'row' if len(table.rows) == 1 else 'rows'}"
    unfolded = " open" if is_open else ""
    return (
        f'<details id="{escape(table.name)}"{unfolded}><summary>{escape(table.title)} '
        f'<span>{count}</span></summary><div class="scroll{width}">{_rows(table)}</div>{note}</details>'
    )


def _rows(table: Table) -> str:
    numeric = [
        all(_is_number(row[column]) or row[column] is None for row in table.rows)
        for column in range(len(table.columns))
    ]

    def cell(tag: str, column: int, value: Any, extra: str = "") -> str:
        name = ' class="number"' if numeric[column] else ""
        exact = f' data-value="{escape(_exact(value))}"' if _is_number(value) else ""
        return f"<{tag}{name}{extra}{exact}>{escape(text(value))}</{tag}>"

    head = "".join(cell("th", i, name, ' scope="col"') for i, name in enumerate(table.columns))
    rows = "".join(
        "<tr>"
        + "".join(
            cell("th" if i == 0 else "td", i, value, ' scope="row"' if i == 0 else "")
            for i, value in enumerate(row)
        )
        + "</tr>"
        for row in table.rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _provenance(material: Material) -> str:
    lines = []
    for run in material.runs:
        made = run.record.provenance
        seed = f", seed {made.seed}" if made.seed is not None else ""
        lines.append(
            f"{run.label}: {made.producer.name} {made.producer.version} ({made.producer.commit}){seed}"
        )
    for name, artifact in (("cover", material.cover), ("scene", material.scene), ("plan", material.plan)):
        if artifact is not None:
            producer = artifact.manifest.producer
            lines.append(f"{name}: {producer.name} {producer.version} ({producer.commit})")
    items = "".join(f"<p>{escape(line)}</p>" for line in lines)
    return f"<details><summary>Written by</summary>{items}</details>" if items else ""
