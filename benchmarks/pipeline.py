"""The stages of the pipeline and plain references, side by side in one run.

Every figure is a cost and every ratio is ours / reference, so below 1 is in our favour. Times are CPU
seconds of one thread, measured in turns; the ratio is the median over the runs, with minimum and
maximum. Times are not tested; a pair that does not give the same answer fails the run.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its idle threads count as CPU time
sys.path.append(str(Path(__file__).resolve().parent))

from measure import Row
from rows import FULL, QUICK, all_rows

_HEADINGS = ("what", "ours", "reference", "", "ratio", "spread", "same answer")


def cells(row: Row) -> tuple[str, ...]:
    """Format a row of the table."""
    low, high = row.spread
    return (
        row.subject,
        f"{row.ours:.4g} {row.unit}",
        f"{row.reference:.4g} {row.unit}",
        row.against,
        f"{row.ratio:.3g}",
        f"{low:.3g}–{high:.3g} ({row.runs})" if row.runs > 1 else "exact",
        ("yes: " if row.agrees else "NO: ") + row.check,
    )


def main() -> int:
    """Run all comparisons; return 1 when a pair disagrees."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small inputs, a few seconds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all figures to FILE")
    options = parser.parse_args()
    rows: list[Row] = []
    print(f"| {' | '.join(_HEADINGS)} |\n|{' --- |' * len(_HEADINGS)}")
    with tempfile.TemporaryDirectory(prefix="alula-bench-") as folder:
        for row in all_rows(QUICK if options.quick else FULL, Path(folder)):
            rows.append(row)
            print(f"| {' | '.join(cells(row))} |", flush=True)
    if options.json is not None:
        document = {
            "quick": options.quick,
            "machine": f"{platform.machine()}, {os.cpu_count()} processors",
            "python": platform.python_version(),
            "rows": [dataclasses.asdict(row) for row in rows],
        }
        options.json.write_text(json.dumps(document, indent=2) + "\n")
    return 0 if all(row.agrees for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
