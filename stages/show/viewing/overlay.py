"""What stands over the scene of a page: the flight in words, a legend, plots, and a picture without WebGL."""

from __future__ import annotations

from importlib.resources import files

from alula.stages.reporting.style import colors

MARKUP = """
<div id="alula" class="no-plots">
<details id="alula-head" open><summary>TITLE</summary>
<p id="alula-choice"></p><p id="alula-words"></p><p id="alula-now"></p>
<p id="alula-legend"></p><p id="alula-notes" class="soft"></p>
</details><figure id="alula-still" hidden>STILL<figcaption id="alula-why">This browser cannot draw
in three dimensions: it needs WebGL 2 and scripts.</figcaption></figure>
<noscript><style>#alula-still[hidden] { display: flex; }</style></noscript>
<div id="alula-plots" role="img" aria-label="Curves of the flight over its time"></div></div>
"""


def asset(name: str) -> str:
    """Text of a file beside this module."""
    return files("alula.stages.show.viewing").joinpath(name).read_text(encoding="utf-8")


def style() -> str:
    """Style sheet of what stands over the scene, in the colours of reports."""
    dark = f"@media (prefers-color-scheme: dark) {{ #alula {{ {colors(dark=True)} }} }}"
    return f"#alula {{ {colors(dark=False)} }}\n{dark}\n{asset('overlay.css')}"
