"""Folders of the repository that tests read from."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "benchmarks"
DOCS = ROOT / "docs"
EXAMPLES = ROOT / "examples"
VEHICLES = EXAMPLES / "vehicles"
SUPPORT = ROOT / "tests" / "support"
