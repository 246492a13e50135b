"""Parameters of `merge`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from alula.schemas.errors import UsageError

DEFAULT_HULLS = 300


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeConfig:
    """Parameters of `merge`; without any of the three limits, `hulls` is `DEFAULT_HULLS`.

    `hulls` and `max_planes` are budgets: merging stops as soon as they hold. `max_growth` bounds the
    price; alone, it asks for as few hulls as it allows.
    """

    hulls: int | None = field(
        default=None,
        metadata={"help": f"At most this many hulls; {DEFAULT_HULLS} when no limit is given."},
    )
    max_planes: int | None = field(default=None, metadata={"help": "At most this many half-planes in all."})
    max_growth: float | None = field(
        default=None, metadata={"help": "Volume of the cover over that of the voxels, at most (1.1: +10 %)."}
    )
    block: int = field(
        default=1, metadata={"help": "Start from clusters of voxels up to this many voxels apart."}
    )
    method: Literal["default", "paper"] = field(
        default="default",
        metadata={
            "help": "default: merge where the excess grows least, then tighten; paper: the published rule."
        },
    )

    def __post_init__(self) -> None:
        """Refuse values that mean nothing; choose the default limit."""
        if self.hulls is None and self.max_planes is None and self.max_growth is None:
            object.__setattr__(self, "hulls", DEFAULT_HULLS)
        if self.hulls is not None and self.hulls < 1:
            raise UsageError(f"--hulls must be at least 1, not {self.hulls}")
        if self.max_planes is not None and self.max_planes < 1:
            raise UsageError(f"--max-planes must be at least 1, not {self.max_planes}")
        if self.max_growth is not None and not (1 <= self.max_growth < math.inf):
            raise UsageError(f"--max-growth must be at least 1, not {self.max_growth}")
        if not (0 <= self.block <= 8):
            raise UsageError(f"--block must be between 0 and 8, not {self.block}")
