"""Room about a point that a curve must pass: a ball, or the disc of a gate."""

from __future__ import annotations

from dataclasses import dataclass

from alula.schemas.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Opening:
    """Where a curve may pass: a ball about the centre, or the disc across a unit normal, along it.

    Attributes:
        centre: shape (3,) [m].
        normal: shape (3,), unit length; zero for a ball.
        radius_m: of ball or disc [m].
    """

    centre: FloatArray
    normal: FloatArray
    radius_m: float

    @property
    def is_disc(self) -> bool:
        """Whether it has a direction."""
        return bool(self.normal.any())
