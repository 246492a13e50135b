"""The numbers that the papers print, by paper; `PAPER.toml` says what they are."""

from __future__ import annotations

from papers.claims import published

POLYMERGE = published("polymerge")
POLYMERGE_SCENES, POLYMERGE_SIZES, POLYMERGE_FLIGHTS = (
    POLYMERGE[name] for name in ("scenes", "sizes", "flights")
)
FASTBRIDGE, DRACBF, GEOFENCING = (published(name) for name in ("fastbridge", "dr-acbf", "geofencing"))
DRACBF_PRINTED = DRACBF["printed"]
