"""One self-contained HTML page from tables, figures and a 3D view."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from alula.stages.reporting.figures import Figure
from alula.stages.reporting.headline import Card, cards, chain
from alula.stages.reporting.material import Material
from alula.stages.reporting.table import Table, text
from alula.stages.reporting.view3d import View

_FOLDED_ROWS = 15  # longer tables are collapsed
_DENSE_COLUMNS = 10  # wider tables get narrower cells

# The policy blocks every fetch, also those of the 3D view; its code and workers are inside the page.
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "script-src 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src blob: data:; connect-src data: blob:"
)
_STYLE = """
:root { --ink: #1c2430; --soft: #5b6673; --line: #e2e6ea; --back: #f6f7f9; --accent: #0072b2; }
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--back); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "DejaVu Sans", sans-serif;
}
main { max-width: 1160px; margin: 0 auto; padding: 28px 24px 60px; }
h1 { font-size: 28px; line-height: 1.2; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 19px; margin: 38px 0 12px; }
h3 { font-size: 15px; margin: 20px 0 8px; color: var(--soft); font-weight: 600; overflow-wrap: anywhere; }
p { margin: 6px 0; }
.soft, figcaption { color: var(--soft); font-size: 13.5px; }
.panel, .card, figure { background: #fff; border: 1px solid var(--line); border-radius: 8px; }
.chain { display: flex; flex-wrap: wrap; gap: 0 6px; padding: 14px 18px; margin-top: 20px; }
.chain div { padding: 2px 8px; }
.chain b { display: block; font-size: 21px; font-variant-numeric: tabular-nums; }
.chain span { color: var(--soft); font-size: 13px; }
.chain i { align-self: center; color: #9aa4af; font-style: normal; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(205px, 1fr)); gap: 12px; }
.card { padding: 13px 16px; border-left: 4px solid #c3cad2; }
.card b { display: block; font-size: 24px; line-height: 1.25; font-variant-numeric: tabular-nums; }
.card span { font-weight: 600; font-size: 13.5px; }
.card small { color: var(--soft); display: block; font-size: 12.5px; }
.good { border-left-color: #2a9d5c; }
.bad { border-left-color: #d7301f; }
.bad b { color: #b3200f; }
.figures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 14px; }
figure { margin: 0; padding: 14px; }
figure img { width: 100%; height: auto; }
figure h3 { margin: 0 0 6px; color: var(--ink); }
figure.wide { grid-column: 1 / -1; text-align: center; }
figure.wide img { max-width: 960px; }
figure.wide h3, figure.wide figcaption { text-align: left; }
iframe {
  display: block; width: 100%; height: 640px; background: #fafbfc;
  border: 1px solid var(--line); border-radius: 8px;
}
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; }
.narrow { width: fit-content; max-width: 100%; }
th, td {
  text-align: left; padding: 6px 12px; vertical-align: top;
  border-bottom: 1px solid var(--line); overflow-wrap: break-word;
}
thead th { color: var(--soft); font-weight: 600; border-bottom-width: 2px; }
tbody th { font-weight: 500; }
tbody tr:last-child > * { border-bottom: 0; }
tbody tr:hover { background: #f8fafb; }
.dense table { font-size: 12.5px; }
.dense th, .dense td { padding: 5px 6px; }
.dense tbody th, .dense tbody td { white-space: nowrap; }
.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number { white-space: nowrap; }
summary { cursor: pointer; padding: 10px 12px; color: var(--accent); font-weight: 600; font-size: 14px; }
@media (max-width: 800px) {
  .figures { grid-template-columns: 1fr; }
  iframe { height: 420px; }
}
@media print {
  body { background: #fff; }
  iframe, summary { display: none; }
  figure, .card, tr { break-inside: avoid; }
}
"""


def page(
    material: Material,
    tables: Sequence[Table],
    figures: Sequence[Figure],
    view: View | None,
    provenance_line: str = "",
    facts: Mapping[str, str] | None = None,
) -> str:
    """Write the page; it loads nothing from elsewhere, and every name in it is escaped.

    Args:
        material: what the report is about.
        tables: in reading order.
        figures: in reading order.
        view: the 3D view, shown in a sandboxed frame.
        provenance_line: put into the head, where `read_provenance` finds it.
        facts: summary lines by subject.

    Returns:
        The HTML text.
    """
    head = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<!-- {comment(provenance_line)} -->" if provenance_line else "",
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(material.title)}</title>",
        f"<style>{_STYLE}</style></head><body><main>",
        f"<h1>{escape(material.title)}</h1>",
        f'<p class="soft">{escape(_subtitle(material))}</p>',
        _chain(material),
    ]
    body = [_cards(title, group) for title, group in cards(material)]
    body += [_in_short(facts or {}), _guarantees(material)]
    if figures:
        body += ["<h2>Figures</h2>", '<div class="figures">', *map(_figure, figures), "</div>"]
    if view is not None:
        body.append(_view(view))
    body += [_table(table) for table in tables]
    return (
        "\n".join(part for part in [*head, *body, _provenance(material), "</main></body></html>"] if part)
        + "\n"
    )


def comment(line: str) -> str:
    """Escape JSON text for an HTML comment: JSON's own escapes hide the characters that would end it."""
    return line.replace("--", "-\\u002d").replace(">", "\\u003e").replace("<", "\\u003c")


def _subtitle(material: Material) -> str:
    trials = sum(len(run.record.trials) for run in material.runs)
    parts = []
    if material.runs:
        filters = ", ".join(dict.fromkeys(run.record.filter for run in material.runs))
        vehicles = ", ".join(dict.fromkeys(run.record.vehicle for run in material.runs))
        parts.append(
            f"{text(trials)} trials in {len(material.runs)} {'run' if len(material.runs) == 1 else 'runs'}"
        )
        parts += [f"filter {filters}", f"vehicle {vehicles}"]
    if material.cover is not None:
        parts.append(f"voxels of {text(material.cover.manifest.voxel_size_m)} m")  # type: ignore[attr-defined]
    return " · ".join(parts)


def _chain(material: Material) -> str:
    links = [
        f"<div><b>{escape(count)}</b><span>{escape(what)}</span></div>" for count, what in chain(material)
    ]
    return f'<div class="panel chain">{"<i>→</i>".join(links)}</div>' if links else ""


def _cards(title: str, group: Sequence[Card]) -> str:
    tone = {None: "", True: " good", False: " bad"}
    items = "".join(
        f'<div class="card{tone[card.good]}"><span>{escape(card.label)}</span><b>{escape(card.value)}</b>'
        f"<small>{escape(card.detail)}</small></div>"
        for card in group
    )
    return f'<h3>{escape(title)}</h3><div class="cards">{items}</div>'


def _guarantees(material: Material) -> str:
    statements = []
    if material.cover is not None and material.cover.manifest.guarantee is not None:
        statements.append(("The map", material.cover.manifest.guarantee.statement))
    if material.certificate is not None and (left_out := material.certificate.get("left_out")):
        statements.append(("Outside the proof", f"{left_out}."))
    for run in material.runs:
        statements.append((run.label, run.record.guarantee.statement))
    lines = _lines((subject, statement) for subject, statement in statements if statement)
    return f"<h2>Guarantees</h2>{lines}" if lines else ""


def _in_short(facts: Mapping[str, str]) -> str:
    lines = _lines(facts.items())
    return f"<h2>In short</h2>{lines}" if lines else ""


def _lines(statements: Iterable[tuple[str, str]]) -> str:
    return "".join(f"<p><b>{escape(subject)}:</b> {escape(line)}</p>" for subject, line in statements)


def _figure(figure: Figure) -> str:
    data = base64.b64encode(figure.svg.encode()).decode()
    wide = ' class="wide"' if figure.wide else ""
    return (
        f'<figure{wide}><h3>{escape(figure.title)}</h3><img src="data:image/svg+xml;base64,{data}" '
        f'alt="{escape(figure.alt)}"><figcaption>{escape(figure.alt)}</figcaption></figure>'
    )


def _view(view: View) -> str:
    note = (
        f"{view.note} Drag to turn, scroll to zoom; the button in the lower right corner lists the parts. "
        "The view needs WebGL; the maps show the same from above."
    )
    return (
        '<h2>In three dimensions</h2><iframe title="3D view of scene, map and flights" '
        f'sandbox="allow-scripts" loading="lazy" srcdoc="{escape(view.html)}"></iframe>'
        f'<p class="soft">{escape(note.strip())}</p>'
    )


def _table(table: Table) -> str:
    numeric = [
        all(_is_number(row[column]) or row[column] is None for row in table.rows)
        for column in range(len(table.columns))
    ]

    def cell(tag: str, column: int, word: str, extra: str = "") -> str:
        name = ' class="number"' if numeric[column] else ""
        return f"<{tag}{name}{extra}>{escape(word)}</{tag}>"

    head = "".join(cell("th", i, name, ' scope="col"') for i, name in enumerate(table.columns))
    rows = "".join(
        "<tr>"
        + "".join(
            cell("th" if i == 0 else "td", i, text(value), ' scope="row"' if i == 0 else "")
            for i, value in enumerate(row)
        )
        + "</tr>"
        for row in table.rows
    )
    inner = f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody>"
    whole = f'<div class="scroll"><table>{inner}</table></div>'
    if len(table.rows) > _FOLDED_ROWS and table.name != "runs":
        whole = f"<details><summary>{len(table.rows)} rows</summary>{whole}</details>"
    note = f'<p class="soft">{escape(table.note)}</p>' if table.note else ""
    title = f"<h2>{escape(table.title)}</h2>"
    width = " narrow" if len(table.columns) <= 4 else " dense" if len(table.columns) > _DENSE_COLUMNS else ""
    return (
        f'<section id="{escape(table.name)}">{title}<div class="panel{width}">{whole}</div>{note}</section>'
    )


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
    return f'<h2>Written by</h2><div class="soft">{items}</div>' if items else ""
