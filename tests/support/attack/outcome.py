"""What one search found."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class Outcome:
    """Counts of a search, and what contradicts a claim.

    Attributes:
        claim: what the search tries to contradict, one sentence.
        tried: number of random cases.
        counts: named counts that show that the search reached its subject, such as "certified" or "refused".
        contradictions: one line each, with what is needed to repeat the case; empty where the claim held.
    """

    claim: str
    tried: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    contradictions: list[str] = field(default_factory=list)

    def row(self) -> str:
        """The row of the table in `docs/theory/guarantee.md`."""
        counts = ", ".join(f"{count:,} {name}" for name, count in sorted(self.counts.items()))
        return f"| {self.claim} | {self.tried:,} | {counts} | {len(self.contradictions)} |"
