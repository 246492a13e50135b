"""Parameters of `demo-scene`."""

from __future__ import annotations

from dataclasses import dataclass

from alula.schemas.parameters.configs.config import Config, option


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoSceneConfig(Config):
    """Parameters of `demo-scene`."""

    gaussians: int = option(200_000, "Number of Gaussians, 2,000 to 20,000,000.", within=(2_000, 20_000_000))
    images: int = option(60, "Number of camera positions, 4 to 10,000.", within=(4, 10_000))
