"""Parameters of `demo-scene`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoSceneConfig:
    """Parameters of `demo-scene`."""

    gaussians: int = field(default=200_000, metadata={"help": "Number of Gaussians, 2,000 to 20,000,000."})
    images: int = field(default=60, metadata={"help": "Number of camera positions, 4 to 10,000."})

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        if not (2_000 <= self.gaussians <= 20_000_000):
            raise UsageError(f"--gaussians must be between 2000 and 20000000, not {self.gaussians}")
        if not (4 <= self.images <= 10_000):
            raise UsageError(f"--images must be between 4 and 10000, not {self.images}")
