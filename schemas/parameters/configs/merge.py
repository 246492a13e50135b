"""Parameters of `merge`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, option

DEFAULT_HULLS = 300
KDOPS = (6, 14, 18, 26)
BOX_PLANES = 6  # the hull of voxels has a facet on each side of its bounding box
_MAX_PLANES = 10**6


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeConfig(Config):
    """Parameters of `merge`; without any of the four limits, `hulls` is `DEFAULT_HULLS`.

    `hulls`, `max_planes` and `max_bytes` are budgets: merging stops as soon as they hold. `max_growth`
    bounds the volume; alone, it gives the smallest number of hulls within that bound. `facet_cap` is a
    number, "auto" or "none". "auto" distributes a budget of planes or bytes; with `hulls` alone it saves the
    planes without which the volume of the cover is no larger. None chooses "auto" where the default method
    has a budget of planes or bytes, or no limit at all.
    """

    hulls: int | None = option(
        None, f"Maximum number of hulls; {DEFAULT_HULLS} when no limit is given.", ge=1
    )
    max_planes: int | None = option(None, "Maximum number of half-planes of all hulls together.", ge=1)
    max_bytes: int | None = option(None, "Maximum size as an onboard map (see export) [bytes].", ge=1)
    max_growth: float | None = option(
        None, "Maximum volume of the cover over that of the voxels (1.1: +10 %).", ge=1
    )
    facet_cap: str | int | None = option(
        None,
        "Replace hulls by outer polytopes of at most F planes; auto distributes --max-planes or "
        "--max-bytes to where planes remove most volume, and with --hulls saves the planes without which "
        "the volume is no larger, in two to three times the time. It is the default with --max-planes or "
        "--max-bytes, and when no limit is given.",
        metavar="F|auto|none",
    )
    kdop: int | None = option(
        None, "Replace hulls by polytopes with this many planes of fixed normals.", metavar="6|14|18|26"
    )
    cluster_radius: int = option(
        1, "Start from clusters of voxels up to this many voxels apart.", within=(0, 8)
    )
    block_m: float | None = option(
        None,
        "Cover blocks of this edge on their own, then join their hulls [m]. Without it, more than "
        "16,777,216 voxels get blocks of at most 1,048,576 voxels.",
        group="Blocks",
        gt=0,
        le=1e6,
    )
    per_block: bool = option(
        False, "The limits hold for each block, and blocks are not joined; needs --block.", group="Blocks"
    )
    method: Literal["default", "paper"] = option(
        "default",
        "default: merge where the excess volume grows least, tighten, and divide voxels between neighbours "
        "anew; paper: the published rule. At equal hulls default mostly has 15 to 35 % less excess than "
        "paper, in 1 to 2.6 times the time.",
    )

    def __post_init__(self) -> None:
        """Check the values, and choose the default limit."""
        limits = (self.hulls, self.max_planes, self.max_bytes, self.max_growth)
        is_free = all(limit is None for limit in limits)
        if is_free:
            object.__setattr__(self, "hulls", DEFAULT_HULLS)
        Config.__post_init__(self)
        if self.per_block and self.block_m is None:
            raise UsageError("--per-block needs --block, the edge of the blocks")
        object.__setattr__(self, "facet_cap", self._resolved_cap(is_free))
        if self.kdop is not None and self.kdop not in KDOPS:
            raise UsageError(f"--kdop must be 6, 14, 18 or 26, not {self.kdop}")

    @property
    def saves_planes(self) -> bool:
        """Whether the planes that the volume of `hulls` hulls does not need are saved."""
        return self.facet_cap == "auto" and self.max_planes is None and self.max_bytes is None

    def _resolved_cap(self, is_free: bool) -> str | int:
        """The cap as a number, "auto" or "none"; `is_free` without any limit."""
        cap, has_budget = self.facet_cap, self.max_planes is not None or self.max_bytes is not None
        if cap is None:
            is_auto = (has_budget or is_free) and self.kdop is None and self.method == "default"
            return "auto" if is_auto else "none"
        if isinstance(cap, str) and cap.isdecimal():
            cap = int(cap)
        if isinstance(cap, str) and cap not in ("auto", "none"):
            raise UsageError(f"--facet-cap must be a number, auto or none, not {cap!r}")
        if isinstance(cap, int) and not (BOX_PLANES <= cap <= _MAX_PLANES):
            raise UsageError(f"--facet-cap must be between {BOX_PLANES} and {_MAX_PLANES}, not {cap}")
        if cap == "auto" and not has_budget and (self.hulls is None or self.max_growth is not None):
            raise UsageError(
                "--facet-cap auto distributes a budget; give --max-planes, --max-bytes or --hulls alone"
            )
        if cap == "auto" and self.method == "paper":
            raise UsageError("--facet-cap auto is not part of --method paper; give a number")
        if cap != "none" and self.kdop is not None:
            raise UsageError("--facet-cap and --kdop exclude each other")
        return cap
