"""The table `[filter]` of scenarios with moving obstacles."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from alula.schemas.filter_options import NATIVE_NAMES, NATIVE_VALUES, MovingFilterParameters

MovingFilterName = Literal["dr-acbf", "dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf", "none"]
_PARAMETERS = "dr-acbf"  # all of them have its parameters


class FilterTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The filter and its parameters."""

    name: MovingFilterName = "dr-acbf"
    parameters: MovingFilterParameters = MovingFilterParameters()


def native_options(parameters: MovingFilterParameters) -> dict[str, float]:
    """The parameters as options of `alula._core.moving_filter`.

    Args:
        parameters: of a scenario; what they leave to the vehicle is left out.

    Returns:
        Numbers by native name, those of a nested table with its name before theirs.
    """
    names, numbers = NATIVE_NAMES[_PARAMETERS], NATIVE_VALUES[_PARAMETERS]
    options: dict[str, float] = {}
    values: dict[str, Any] = msgspec.structs.asdict(parameters)
    for name, value in values.items():
        if isinstance(value, msgspec.Struct):
            options |= {f"{name}_{key}": float(own) for key, own in msgspec.structs.asdict(value).items()}
        elif value is not None:
            options[names.get(name, name)] = float(numbers[name][value] if name in numbers else value)
    return options
