"""Parameters of `export`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, option

SUFFIXES = {
    ".glb": "glb",
    ".obj": "obj",
    ".json": "json",
    ".ply": "ply",
    ".splat": "splat",
    ".spz": "spz",
    ".stl": "stl",
    ".bin": "onboard",
    ".h": "c-header",
    ".xml": "mjcf",
    ".usda": "usda",
    ".bt": "octomap",
    ".pcd": "pcd",
    ".npz": "field",
    ".geojson": "geojson",
}
ONBOARD = ("onboard", "c-header")
FOLDERS = ("urdf", "gazebo")  # formats of several files


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportConfig(Config):
    """Parameters of `export`."""

    format: Literal[
        "auto",
        "glb",
        "obj",
        "json",
        "ply",
        "splat",
        "spz",
        "stl",
        "onboard",
        "c-header",
        "mjcf",
        "usda",
        "urdf",
        "gazebo",
        "octomap",
        "pcd",
        "field",
        "geojson",
    ] = option("auto", "Format to write; auto follows the output's suffix. urdf and gazebo write a folder.")
    target: Literal["none", "crazyflie", "teensy", "c"] = option(
        "none",
        "Onboard map for a microcontroller: with an index, and a C header beside the image; prints the "
        "worst time of a tick. A map that does not fit is refused; c has no limits.",
    )
    rate_hz: float | None = option(
        None,
        "Rate at which the target calls the filter [Hz]; a map whose worst tick takes longer than its "
        "period is refused with exit code 4; default: 100 on a crazyflie, no check elsewhere.",
        group="Onboard maps",
        gt=0,
        le=1e6,
    )
    obstacles: int = option(
        0,
        "Maximum number of moving obstacles of the crazyflie's app, its OBSTACLES: they cost memory, and "
        "time of a tick. What does not fit is refused with exit code 4 or 5; 0: hulls alone.",
        group="Onboard maps",
        metavar="N",
        within=(0, 128),
    )
    largest_normal: int = option(
        127,
        "Onboard map: maximum component of a plane's integer normal, 1 to 127. Only 1 makes the map "
        "smaller: 2 bytes per oblique plane, all in 26 directions.",
        group="Onboard maps",
        metavar="Q",
        within=(1, 127),
    )

    tiles_m: float | None = option(
        None,
        "Onboard map in tiles of this edge along x and y, a folder, of which a vehicle holds two; requires "
        "--reach [m].",
        metavar="METRES",
        gt=0,
        le=1e6,
    )
    reach_m: float | None = option(
        None,
        "Tiles: each has all hulls within this distance of it; the filter must not depend on others [m].",
        group="Maps in tiles",
        metavar="METRES",
        gt=0,
        le=1e6,
    )
    hysteresis_m: float | None = option(
        None,
        "Tiles: a tile is valid up to this distance beyond its borders; default: an eighth of a tile [m].",
        group="Maps in tiles",
        metavar="METRES",
        gt=0,
        le=1e6,
    )
    ros2: bool = option(
        False, "Write a run as a bag of ROS 2 (rosbag2 with MCAP), a folder; requires alula[ros2]."
    )
    foxglove_layout: bool = option(
        False, "Write a layout for Foxglove (.json): for all runs, or for the channels of the INPUT."
    )
    spacing_m: float | None = option(
        None,
        "Distance field: distance between samples [m]; default: the edge of a voxel.",
        group="Distance fields",
        metavar="METRES",
        within=(1e-3, 1e3),
    )
    pad_m: float = option(
        1.0,
        "Distance field: how far it reaches beyond the hulls [m].",
        group="Distance fields",
        metavar="METRES",
        within=(0, 1e3),
    )
    origin: tuple[float, float, float] | None = option(
        None,
        "GeoJSON: latitude and longitude [degree] and WGS84 height [m] of the origin of the map, whose x "
        "points east and y north.",
        group="Other formats",
        metavar="LAT LON HEIGHT",
    )
    spz_version: int = option(
        3,
        "SPZ: version 2, 3 or 4. Nearly all programs read 3; 2 stores rotations less accurately; 4 is newer.",
        group="Other formats",
        metavar="V",
        within=(2, 4),
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.rate_hz is not None and self.target in ("none", "c"):
            raise UsageError("--rate goes with a --target whose clock is known: crazyflie or teensy")
        if self.obstacles > 0 and self.target != "crazyflie":
            raise UsageError("--obstacles goes with --target crazyflie")
        if (self.ros2 or self.foxglove_layout) and (self.format != "auto" or self.target != "none"):
            raise UsageError("--ros2 and --foxglove-layout go with neither --format nor --target")
        self._check_tiles()
        if self.ros2 and self.foxglove_layout:
            raise UsageError("give --ros2 or --foxglove-layout, not both")
        if self.origin is not None and not (abs(self.origin[0]) <= 89.9 and abs(self.origin[1]) <= 180):
            raise UsageError("--origin needs a latitude of -89.9 to 89.9 and a longitude of -180 to 180")

    def _check_tiles(self) -> None:
        if self.tiles_m is None:
            if self.reach_m is not None or self.hysteresis_m is not None:
                raise UsageError("--reach and --hysteresis go with --tiles")
            return
        if self.reach_m is None:
            raise UsageError("--tiles needs --reach: the distance up to which hulls must be in a tile")
        if self.format != "auto" or self.target != "none" or self.ros2 or self.foxglove_layout:
            raise UsageError("--tiles goes with neither --format, --target, --ros2 nor --foxglove-layout")
        if self.hysteresis_m is not None and 2 * self.hysteresis_m > self.tiles_m:
            raise UsageError("--hysteresis must be at most half of --tiles")

    def tile_parameters(self) -> dict[str, Any]:
        """Parameters of a map in tiles, apart from the key."""
        assert self.tiles_m is not None
        hysteresis = self.tiles_m / 8 if self.hysteresis_m is None else self.hysteresis_m
        return {
            "format": "tiles",
            "largest_normal": self.largest_normal,
            "tile_m": self.tiles_m,
            "reach_m": self.reach_m,
            "hysteresis_m": hysteresis,
        }

    def resolved(self, output: Path) -> str:
        """Determine the format for an output file.

        Raises:
            UsageError: the format is `auto` and the suffix belongs to no format; or there is a target and the
                output is not .bin.
        """
        if self.target != "none" and (
            self.format not in ("auto", "onboard") or output.suffix.lower() != ".bin"
        ):
            raise UsageError(f"{output}: with --target the output must end in .bin; the header gets .h")
        if self.format != "auto":
            return self.format
        if (name := SUFFIXES.get(output.suffix.lower())) is None:
            raise UsageError(
                f"{output}: the output must end in one of {', '.join(SUFFIXES)}; or give --format"
            )
        return name

    def parameters(self, output: Path) -> dict[str, Any]:
        """All parameters that determine the output, apart from the input."""
        name = self.resolved(output)
        shaping: dict[str, Any] = {"format": name}
        if name in ONBOARD:
            shaping["largest_normal"] = self.largest_normal
        if self.target != "none":
            shaping |= {"target": self.target, "name": c_name(output)}
            if self.obstacles > 0:
                shaping["obstacles"] = self.obstacles
        if name == "spz":
            shaping["spz_version"] = self.spz_version
        if name == "c-header":
            shaping["name"] = c_name(output)
        if name == "field":
            shaping |= {"spacing_m": self.spacing_m, "pad_m": self.pad_m}
        if name == "geojson":
            shaping["origin"] = None if self.origin is None else list(self.origin)
        return shaping


def c_name(output: Path) -> str:
    """C identifier for a file: its name without the last suffix, ending in map, as no keyword does."""
    name = re.sub(r"\W", "_", output.name.removesuffix(output.suffix), flags=re.ASCII)
    name = name if re.match(r"[A-Za-z]", name) else f"map_{name}"
    return name if name.lower().endswith("map") else f"{name}_map"
