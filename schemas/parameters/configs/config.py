"""Fields of configurations: default, help, limits, and the option of the command line."""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Any

from msgspec import Meta

from alula.schemas.errors import UsageError
from alula.schemas.parameters.filters.values import Options, beyond, entries

_UNIT = re.compile(r"_(per_m|rad_s|rad|hz|m_s[234]?|m|s)$")


def option(
    default: Any = dataclasses.MISSING,
    help: str = "",
    *,
    flag: str | tuple[str, ...] = (),
    group: str = "",
    metavar: str = "",
    within: tuple[float, float] | None = None,
    limits: Meta | None = None,
    **more: Any,
) -> Any:
    """A field of a configuration, and its option.

    Args:
        default: absent for a value that must be given.
        flag: name of the option, or several; default: the field's without its unit.
        group: heading under which the help shows the option.
        within: smallest and largest value of a number, or of each number of a tuple; None is allowed, too.
        limits: in place of that.
        more: fields of `limits`.
    """
    limits = Meta(ge=within[0], le=within[1]) if within else Meta(**more) if more else limits
    metadata = {"help": help, "flag": flag, "group": group, "metavar": metavar, "limits": limits}
    return dataclasses.field(default=default, metadata=metadata)


def box_option(default: Any = dataclasses.MISSING, help: str = "", **keywords: Any) -> Any:
    """A field that is a box, XMIN YMIN ZMIN XMAX YMAX ZMAX; see `option`."""
    return option(default, help, metavar="BOX", **keywords)


def internal(default: Any) -> Any:
    """A field without an option; a class or function makes its default."""
    made_by = "default_factory" if callable(default) else "default"
    return dataclasses.field(**{made_by: default}, metadata={"internal": True})


def config_field(options: type[Options], name: str, **keywords: Any) -> Any:
    """A field that takes a parameter of a filter: its default, its help and its limits; see `option`."""
    entry = entries(options)[name]
    return option(entry.default, entry.help, limits=entry.meta, **keywords)


def flags_of(field: dataclasses.Field[Any]) -> tuple[str, ...]:
    """Names of a field's option on the command line; the first one is in messages."""
    names: str | tuple[str, ...] = field.metadata.get("flag") or "--" + _UNIT.sub("", field.name).replace(
        "_", "-"
    )
    return (names,) if isinstance(names, str) else names


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """A configuration; a class with further checks calls `Config.__post_init__` before them."""

    def __post_init__(self) -> None:
        """Refuse values beyond the limits of their fields, and boxes without an inside."""
        for field in dataclasses.fields(self):
            value, flag = getattr(self, field.name), flags_of(field)[0]
            if value is None:
                continue
            if field.metadata.get("limits") is not None:
                for one in value if isinstance(value, tuple) else (value,):
                    require_within(flag, one, field.metadata["limits"])
            if field.metadata.get("metavar") == "BOX" and not all(value[i] < value[i + 3] for i in range(3)):
                raise UsageError(f"{flag} needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")


def require_within(flag: str, value: float, limits: Meta) -> None:
    """Refuse a value that is beyond limits, or not finite.

    Raises:
        UsageError: it is; the message begins with the flag.
    """
    words = beyond(limits, value) or ("" if math.isfinite(value) else f"must be finite, not {value:g}")
    if words:
        raise UsageError(f"{flag} {words}")
