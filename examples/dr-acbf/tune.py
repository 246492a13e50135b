"""Print the setting that tuning chooses for a method, as options of `alula simulate`.

Usage: python tune.py METHOD RUN [RUN ...]

A run is METHOD_CONDITION_SETTING.run.mcap with its record beside it.
"""

import sys
from pathlib import Path

from alula.schemas.log.run import read_run
from papers.dracbf.difficulty import chosen
from papers.dracbf.tables import Flown

method, paths = sys.argv[1], [Path(word) for word in sys.argv[2:]]
runs = [Flown(path.parent.name, path.name.removesuffix(".run.mcap"), read_run(path)) for path in paths]
print(" ".join(f"--set {word}" for word in chosen(runs, method).options))
