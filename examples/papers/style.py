"""Style sheet of the page of all papers, in addition to that of reports."""

from __future__ import annotations

from alula.stages.reporting.palette import BLUE, GREEN, GREY, GRID, ORANGE, VERMILLION
from papers.compared import VERDICTS, Verdict

_COLOURS: dict[Verdict, str] = {
    "better": GREEN,
    "reproduced": BLUE,
    "bounded": ORANGE,
    "refuted": VERMILLION,
    "not comparable": GREY,
    "not available here": GRID,
}


def name_of(verdict: str) -> str:
    """A verdict as a name in the style sheet."""
    return verdict.replace(" ", "-")


def _colours() -> str:
    return "\n".join(
        f".{name_of(name)} {{ --of: var(--c{colour[1:]}); }}" for name, colour in _COLOURS.items()
    )


def _filters() -> str:
    return "\n".join(
        f'main:has(#only-{name_of(name)}:checked) tbody[data-verdict]:not([data-verdict="{name_of(name)}"]) '
        "{ display: none; }"
        for name in VERDICTS
    )


PAPERS_STYLE = f"""
{_colours()}
{_filters()}
.bar {{ display: flex; height: 14px; border-radius: 4px; overflow: hidden; min-width: 120px;
  background: var(--line); }}
.bar i {{ display: block; background: var(--of); }}
.chip {{ display: inline-block; padding: 0 8px; border-radius: 9px; border: 2px solid var(--of);
  font-size: 13px; font-weight: 600; white-space: nowrap; }}
.chip::before {{ content: ""; display: inline-block; width: 9px; height: 9px; border-radius: 50%;
  background: var(--of); margin-right: 6px; }}
.tally {{ list-style: none; margin: 0; padding: 0; display: flex; flex-wrap: wrap; gap: 6px 10px; }}
.tally b {{ font-variant-numeric: tabular-nums; }}
.overview {{ display: grid; gap: 14px; }}
.overview h3 {{ margin: 0 0 4px; }}
.overview p {{ margin: 0 0 6px; }}
.overview .bar, .say > .bar {{ margin-bottom: 8px; }}
.words {{ display: grid; grid-template-columns: max-content minmax(0, 1fr);
  gap: 6px 12px; margin: 0 0 10px; }}
.words dd {{ margin: 0; }}
.choose {{ position: sticky; top: 0; z-index: 2; margin: 26px 0 0; padding: 8px 14px; display: flex;
  flex-wrap: wrap; gap: 4px 16px; font-size: 14px; }}
.choose legend {{ float: left; font-weight: 600; padding: 0; margin-right: 6px; }}
.choose label {{ cursor: pointer; white-space: nowrap; }}
.choose input {{ accent-color: var(--accent); margin: 0 5px 0 0; vertical-align: -1px; }}
.claims {{ table-layout: fixed; }}
.claims th, .claims td {{ overflow-wrap: anywhere; }}
.claims col.what {{ width: 20%; }}
.claims col.printed {{ width: 14%; }}
.claims col.ours {{ width: 19%; }}
.claims col.interval {{ width: 13%; }}
.claims tbody tr.claim > * {{ background: var(--hover); border-bottom: 0; padding-top: 10px; }}
.claims tbody tr.claim th {{ font-weight: 600; }}
.claims .where {{ color: var(--soft); font-weight: 400; margin-right: 8px; }}
.claims .printed {{ color: var(--soft); font-weight: 400; margin-left: 8px; }}
.claims tbody tr:hover {{ background: none; }}
.claims small {{ display: block; color: var(--soft); font-size: 12px; margin-top: 3px; }}
.claims code, .made code {{ font-size: 11.5px; overflow-wrap: anywhere; }}
.claims details {{ border: 0; background: none; margin: 0; }}
.claims details > *:not(summary) {{ margin: 0; }}
.claims summary {{ padding: 0; font-size: 12px; font-weight: 400; border: 0; }}
.beside {{ display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 3fr);
  gap: 18px; align-items: start; }}
.beside > div > p {{ font-size: 14px; }}
.drawn {{ display: grid; gap: 14px; }}
.drawn figure {{ padding: 10px; }}
@media (max-width: 860px) {{
  .beside {{ grid-template-columns: minmax(0, 1fr); gap: 6px; }}
  .claims, .claims tbody, .claims tr, .claims td, .claims th {{ display: block; width: auto; }}
  .claims thead, .claims colgroup {{ display: none; }}
  .claims tr {{ border-bottom: 1px solid var(--line); padding: 6px 0; }}
  .claims td, .claims th {{ border: 0; padding: 2px 10px; }}
  .claims td[data-label]:not(:empty)::before {{ content: attr(data-label) ": "; color: var(--soft); }}
  .choose {{ position: static; }}
  .words {{ grid-template-columns: minmax(0, 1fr); }}
}}
"""
