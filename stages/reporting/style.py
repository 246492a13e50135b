"""The style sheet of a report's page: light and dark, wide and narrow, on a screen and on paper.

The page follows the colours of the system; a box, which needs no script, switches to the others.
"""

from __future__ import annotations

from alula.stages.reporting.palette import variables

SWITCH = "other-colours"  # id of the box

_LIGHT = """--ink: #1c2430; --soft: #566270; --line: #dfe4e9; --back: #f5f7f9; --panel: #ffffff;
  --hover: #f3f6f8; --accent: #0065a0; --good: #007a59; --fair: #8a5a00; --bad: #b34400; --stage: #fafbfc;
  color-scheme: light;"""
_DARK = """--ink: #e4e8ed; --soft: #a3adb9; --line: #2c333c; --back: #12161b; --panel: #1a2027;
  --hover: #212932; --accent: #6bbbe8; --good: #36c79a; --fair: #f0b432; --bad: #f58f4a; --stage: #161b21;
  color-scheme: dark;"""


def colors(*, dark: bool) -> str:
    """Variables of the style sheet: the colours of a page in the light or in the dark."""
    return f"{_DARK if dark else _LIGHT} {variables(dark=dark)}"


STYLE = (
    f"""
:root {{ {colors(dark=False)} }}
@media (prefers-color-scheme: dark) {{ :root {{ {colors(dark=True)} }} }}
@media screen and (prefers-color-scheme: light) {{ :root:has(#{SWITCH}:checked) {{ {colors(dark=True)} }} }}
@media screen and (prefers-color-scheme: dark) {{ :root:has(#{SWITCH}:checked) {{ {colors(dark=False)} }} }}
@media print {{ :root {{ {colors(dark=False)} }} }}
"""
    """
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--back); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "DejaVu Sans", sans-serif;
}
main { max-width: 1200px; margin: 0 auto; padding: 20px 24px 60px; }
header { display: flex; align-items: baseline; gap: 6px 18px; flex-wrap: wrap; }
h1 { font-size: 17px; line-height: 1.3; margin: 0; font-weight: 600; overflow-wrap: anywhere; }
header p { flex: 1; min-width: 200px; margin: 0; }
h2 { font-size: 20px; margin: 40px 0 12px; line-height: 1.25; }
h3 { font-size: 15px; margin: 18px 0 8px; font-weight: 600; overflow-wrap: anywhere; }
p { margin: 6px 0; overflow-wrap: anywhere; }
a { color: var(--accent); }
.soft, figcaption { color: var(--soft); font-size: 14px; }
.panel, figure, .hero { background: var(--panel); border: 1px solid var(--line); border-radius: 10px; }
.switch { font-size: 13px; color: var(--soft); cursor: pointer; white-space: nowrap; }
.switch input { vertical-align: -2px; margin: 0 5px 0 0; accent-color: var(--accent); }
:focus-visible { outline: 3px solid var(--accent); outline-offset: 2px; border-radius: 3px; }

.hero { display: grid; grid-template-columns: minmax(0, 5fr) minmax(0, 7fr);
  margin-top: 14px; overflow: hidden; }
.hero.alone { grid-template-columns: 1fr; }
.say { padding: 26px 26px 22px; display: flex; flex-direction: column; gap: 22px;
  justify-content: center; }
.verdict { font-size: clamp(22px, 2.5vw, 31px); line-height: 1.22; font-weight: 700; margin: 0;
  text-wrap: balance; }
.verdict::before { content: ""; display: block; width: 56px; height: 6px; border-radius: 3px;
  margin-bottom: 12px; background: var(--soft); }
.verdict.good::before { background: var(--good); }
.verdict.fair::before { background: var(--fair); }
.verdict.bad::before { background: var(--bad); }
.hero figure { border: 0; border-left: 1px solid var(--line); border-radius: 0; margin: 0; padding: 10px 14px;
  display: flex; flex-direction: column; justify-content: center; background: var(--stage); }
.hero svg { max-height: 600px; }
.hero figcaption { font-size: 12.5px; }
.numbers { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 16px 20px; margin: 0; }
.alone .numbers, .apart .numbers { grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); }
.numbers div { display: flex; flex-direction: column; }
.numbers dt { order: 2; font-size: 14.5px; line-height: 1.3; }
.numbers dd { margin: 0; }
.numbers dd.big { order: 1; font-size: clamp(23px, 2.4vw, 30px); line-height: 1.2; font-weight: 700;
  font-variant-numeric: tabular-nums; }
.numbers dd.more { order: 3; color: var(--soft); font-size: 12.5px; line-height: 1.35; }
.big.good { color: var(--good); }
.big.bad { color: var(--bad); }
.mark data::before { font-size: 0.72em; margin-right: 5px; }
.good.mark data::before { content: "\\2713"; }
.bad.mark data::before { content: "\\2717"; }
.apart { padding: 16px 20px; }
.apart > p:first-child { margin: 0 0 14px; font-weight: 600; }
.dot { display: inline-block; width: 0.72em; height: 0.72em; border-radius: 50%; margin-right: 7px; }

.board td, .board th { padding: 9px 14px 9px 0; }
.board td b { font-size: 21px; line-height: 1.2; white-space: nowrap; font-variant-numeric: tabular-nums; }
.board thead th { font-weight: 600; font-size: 14px; vertical-align: bottom; line-height: 1.3;
  color: var(--ink); }
.board tbody th { font-size: 14px; line-height: 1.3; vertical-align: middle; }
.board th span { color: var(--soft); font-size: 12.5px; display: block; font-weight: 400; }
.board.many td b { font-size: 17px; }
.board.many thead th { font-size: 13px; font-weight: 500; }
.board.many td, .board.many th { padding: 7px 10px 7px 0; }
.board tbody tr:hover { background: none; }
.board td.good b { color: var(--good); }
.board td.bad b { color: var(--bad); }

.chain { display: flex; flex-wrap: wrap; gap: 0 6px; padding: 12px 14px; margin-top: 12px; }
.chain div { padding: 2px 8px; }
.chain b { display: block; font-size: 19px; font-variant-numeric: tabular-nums; }
.chain span { color: var(--soft); font-size: 13px; }
.chain i { align-self: center; color: var(--soft); font-style: normal; }
.promise { list-style: none; margin: 0; padding: 14px 20px; }
.promise li { padding: 4px 0 4px 26px; position: relative; overflow-wrap: anywhere; }
.promise li::before { position: absolute; left: 0; font-weight: 700; }
.promise .yes::before { content: "\\2713"; color: var(--good); }
.promise .no::before { content: "!"; color: var(--fair); left: 5px; }

.said { margin: 0 0 10px; padding: 12px 20px 12px 38px; }
.said li { padding: 2px 0; }

.figures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 14px; }
figure { margin: 0; padding: 14px; }
figure svg { width: 100%; height: auto; display: block; }
svg * { stroke-linejoin: round; stroke-linecap: butt; }
figure h3 { margin: 0 0 6px; }
svg .now { stroke: var(--accent); stroke-width: 1.5; display: none; pointer-events: none; }
figure.wide { grid-column: 1 / -1; }
figure.wide svg { max-width: 960px; margin: 0 auto; }
figure + figure.flight { margin-top: 14px; }
iframe { display: block; width: 100%; height: 640px; background: var(--stage); border: 1px solid var(--line);
  border-radius: 10px; }

details { border: 1px solid var(--line); border-radius: 10px; background: var(--panel); margin: 8px 0; }
details > *:not(summary) { margin-left: 16px; margin-right: 16px; }
details > .scroll { margin: 0; }
summary { cursor: pointer; padding: 10px 16px; font-weight: 600; font-size: 15px; overflow-wrap: anywhere; }
summary span { color: var(--soft); font-weight: 400; }
details[open] > summary { border-bottom: 1px solid var(--line); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
.narrow table { width: auto; max-width: 100%; }
th, td { text-align: left; padding: 6px 14px; vertical-align: top; border-bottom: 1px solid var(--line); }
thead th { color: var(--soft); font-weight: 600; border-bottom-width: 2px; }
tbody th { font-weight: 500; }
tbody tr:last-child > * { border-bottom: 0; }
tbody tr:hover { background: var(--hover); }
.dense table { font-size: 12.5px; }
.dense th, .dense td { padding: 5px 7px; }
.dense tbody th, .dense tbody td { white-space: nowrap; }
.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number { white-space: nowrap; }
@media (max-width: 860px) {
  main { padding: 14px 12px 40px; }
  .hero, .hero.alone { grid-template-columns: minmax(0, 1fr); }
  .hero figure { border-left: 0; border-top: 1px solid var(--line); padding: 8px; }
  .say { padding: 18px 16px; gap: 14px; }
  .figures { grid-template-columns: minmax(0, 1fr); }
  figure { padding: 10px 8px; }
  iframe { height: 440px; }
  .board td b { font-size: 18px; }
  .board td, .board th { padding: 7px 8px 7px 0; }
  figure.wide:not(.flight) .svg { overflow-x: auto; }
}
@media print {
  body { background: #fff; font-size: 12px; }
  iframe, .switch { display: none; }
  figure, .hero, tr { break-inside: avoid; }
}
"""
)
