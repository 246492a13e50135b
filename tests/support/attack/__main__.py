"""Random searches for a false claim: `make attack` takes an hour, `make attack QUICK=1` a minute.

Every search draws inputs that the tool admits, takes what the tool claims of them, and judges the claim by
code of its own. It fails where one claim is false. `--markdown FILE` writes the counts between the marks of
that file.
"""

from __future__ import annotations

import argparse
import importlib
import re
import sys
import time
from pathlib import Path

from support.attack.outcome import Outcome

SHARES: dict[str, float] = {
    "shield": 0.45,
    "plans": 0.15,
    "missions": 0.2,
    "seen": 0.1,
    "meshes": 0.1,
}  # of the time, by module
MARKS = ("<!-- attack -->", "<!-- /attack -->")


def main() -> int:
    """Run the searches and print one row for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=3600.0, help="time of all searches together [s]")
    parser.add_argument("--seed", type=int, default=0, help="of the random cases")
    parser.add_argument("--only", choices=sorted(SHARES), action="append", help="searches to run")
    parser.add_argument("--markdown", type=Path, help="page that gets the counts between its marks")
    given = parser.parse_args()
    names = given.only or list(SHARES)
    whole = sum(SHARES[name] for name in names)
    outcomes: list[Outcome] = []
    for name in names:
        begin = time.monotonic()
        search = importlib.import_module(f"support.attack.{name}").search
        found: Outcome = search(given.seconds * SHARES[name] / whole, given.seed)
        print(f"{name}, {time.monotonic() - begin:.0f} s: {found.row()}", flush=True)
        print(*(f"  {line}" for line in found.contradictions), sep="\n", flush=True)
        outcomes.append(found)
    if given.markdown:
        write(given.markdown, outcomes)
    idle = [found.claim for found in outcomes if not found.tried]
    if idle:
        print(f"nothing was tried: {'; '.join(idle)}", file=sys.stderr)
    return 1 if idle or any(found.contradictions for found in outcomes) else 0


def write(page: Path, outcomes: list[Outcome]) -> None:
    """Put the table of all outcomes between the marks of a page."""
    head = "| claim | cases | of these | contradicted |\n| --- | --- | --- | --- |"
    table = "\n".join([head, *(found.row() for found in outcomes)])
    text = page.read_text()
    begin, end = (re.escape(mark) for mark in MARKS)
    new, found = re.subn(f"{begin}.*{end}", lambda _: f"{MARKS[0]}\n{table}\n{MARKS[1]}", text, flags=re.S)
    if not found:
        sys.exit(f"{page} has no marks {MARKS[0]} and {MARKS[1]}")
    page.write_text(new)


if __name__ == "__main__":
    sys.exit(main())
