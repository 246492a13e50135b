"""The four papers with their claims."""

from __future__ import annotations

from papers.claims import Paper, read_paper
from papers.dracbf.cells import DRACBF_TABLES
from papers.polymerge.cells import POLYMERGE_TABLES

POLYMERGE = read_paper("polymerge", POLYMERGE_TABLES)
FASTBRIDGE = read_paper("fastbridge")
DRACBF = read_paper("dr-acbf", DRACBF_TABLES)
GEOFENCING = read_paper("geofencing")
PAPERS: tuple[Paper, ...] = (POLYMERGE, FASTBRIDGE, DRACBF, GEOFENCING)
