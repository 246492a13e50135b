"""Parameters of `merge`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from alula.schemas.errors import UsageError

DEFAULT_HULLS = 300
KDOPS = (6, 14, 18, 26)
_BOX_PLANES, _MAX_PLANES = 6, 10**6


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeConfig:
    """Parameters of `merge`; without any of the four limits, `hulls` is `DEFAULT_HULLS`.

    `hulls`, `max_planes` and `max_bytes` are budgets: merging stops as soon as they hold. `max_growth`
    bounds the volume; alone, it gives the smallest number of hulls within that bound. `facet_cap` is a
    number, "auto" or "none"; None chooses "auto" where the default method has a budget of planes or bytes
    to distribute.
    """

    hulls: int | None = field(
        default=None,
        metadata={"help": f"Maximum number of hulls; {DEFAULT_HULLS} when no limit is given."},
    )
    max_planes: int | None = field(
        default=None, metadata={"help": "Maximum number of half-planes of all hulls together."}
    )
    max_bytes: int | None = field(
        default=None, metadata={"help": "Maximum size as an onboard map (see export) [bytes]."}
    )
    max_growth: float | None = field(
        default=None, metadata={"help": "Maximum volume of the cover over that of the voxels (1.1: +10 %)."}
    )
    facet_cap: str | int | None = field(
        default=None,
        metadata={
            "metavar": "F|auto|none",
            "help": "Replace hulls by outer polytopes of at most F planes; auto distributes --max-planes or "
            "--max-bytes to where planes remove most volume, and is the default with these.",
        },
    )
    kdop: int | None = field(
        default=None,
        metadata={
            "metavar": "6|14|18|26",
            "help": "Replace hulls by polytopes with this many planes of fixed normals.",
        },
    )
    block: int = field(
        default=1, metadata={"help": "Start from clusters of voxels up to this many voxels apart."}
    )
    method: Literal["default", "paper"] = field(
        default="default",
        metadata={
            "help": "default: merge where the excess volume grows least, then tighten; paper: the published "
            "rule. At equal hulls default mostly has 10 to 30 % less excess than paper."
        },
    )

    def __post_init__(self) -> None:
        """Refuse values out of range and choose the default limit."""
        if all(limit is None for limit in (self.hulls, self.max_planes, self.max_bytes, self.max_growth)):
            object.__setattr__(self, "hulls", DEFAULT_HULLS)
        if self.hulls is not None and self.hulls < 1:
            raise UsageError(f"--hulls must be at least 1, not {self.hulls}")
        if self.max_planes is not None and self.max_planes < 1:
            raise UsageError(f"--max-planes must be at least 1, not {self.max_planes}")
        if self.max_bytes is not None and self.max_bytes < 1:
            raise UsageError(f"--max-bytes must be at least 1, not {self.max_bytes}")
        if self.max_growth is not None and not (1 <= self.max_growth < math.inf):
            raise UsageError(f"--max-growth must be at least 1, not {self.max_growth}")
        if not (0 <= self.block <= 8):
            raise UsageError(f"--block must be between 0 and 8, not {self.block}")
        object.__setattr__(self, "facet_cap", self._resolved_cap())
        if self.kdop is not None and self.kdop not in KDOPS:
            raise UsageError(f"--kdop must be 6, 14, 18 or 26, not {self.kdop}")

    def _resolved_cap(self) -> str | int:
        """The cap as a number, "auto" or "none"."""
        cap, has_budget = self.facet_cap, self.max_planes is not None or self.max_bytes is not None
        if cap is None:
            return "auto" if has_budget and self.kdop is None and self.method == "default" else "none"
        if isinstance(cap, str) and cap.isdecimal():
            cap = int(cap)
        if isinstance(cap, str) and cap not in ("auto", "none"):
            raise UsageError(f"--facet-cap must be a number, auto or none, not {cap!r}")
        if isinstance(cap, int) and not (_BOX_PLANES <= cap <= _MAX_PLANES):
            raise UsageError(f"--facet-cap must be between {_BOX_PLANES} and {_MAX_PLANES}, not {cap}")
        if cap == "auto" and not has_budget:
            raise UsageError("--facet-cap auto distributes a budget; give --max-planes or --max-bytes")
        if cap == "auto" and self.method == "paper":
            raise UsageError("--facet-cap auto is not part of --method paper; give a number")
        if cap != "none" and self.kdop is not None:
            raise UsageError("--facet-cap and --kdop exclude each other")
        return cap
