"""Fields of configurations: limits beside the default, one check and one message for all."""

import dataclasses
import importlib
import math
import pkgutil

import pytest
from msgspec import Meta

from alula.schemas.errors import UsageError
from alula.schemas.parameters import configs
from alula.schemas.parameters.configs.config import Config, box_option, flags_of, internal, option

ALL = sorted(
    {
        found
        for module in pkgutil.iter_modules(configs.__path__)
        for found in vars(importlib.import_module(f"{configs.__name__}.{module.name}")).values()
        if isinstance(found, type) and issubclass(found, Config) and found is not Config
    },
    key=lambda found: found.__name__,
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Example(Config):
    size_m: float = option(1.0, "Size.", gt=0, le=2)
    count: int | None = option(None, "Count.", flag=("--number", "-n"), within=(1, 9))
    speeds_m_s: tuple[float, ...] = option((1.0,), "Speeds.", ge=0.5)
    region: tuple[float, ...] | None = box_option(None, "Region.")
    rest: dict = internal(dict)  # noqa: RUF009


def test_every_configuration_is_one_of_these_and_names_each_option_once():
    assert len(ALL) >= 14
    for found in ALL:
        names = [
            flag for f in dataclasses.fields(found) if "internal" not in f.metadata for flag in flags_of(f)
        ]
        assert len(set(names)) == len(names), found
        assert all(name.startswith("--") for name in names), found


def test_an_option_is_called_like_its_field_without_the_unit():
    flags = {field.name: flags_of(field) for field in dataclasses.fields(Example)}
    assert flags["size_m"] == ("--size",)
    assert flags["speeds_m_s"] == ("--speeds",)
    assert flags["count"] == ("--number", "-n")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"size_m": 0.0}, "--size must be above 0 and at most 2, not 0"),
        ({"size_m": math.nan}, "--size must be above 0 and at most 2, not nan"),
        ({"count": 10}, "--number must be between 1 and 9, not 10"),
        ({"speeds_m_s": (1.0, 0.1)}, "--speeds must be at least 0.5, not 0.1"),
        ({"speeds_m_s": (math.inf,)}, "--speeds must be finite, not inf"),
        ({"region": (0, 0, 0, 1, 0, 1)}, "--region needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX"),
    ],
)
def test_a_value_beyond_its_limits_is_refused_by_the_name_of_its_option(values, words):
    with pytest.raises(UsageError) as error:
        Example(**values)
    assert str(error.value) == words


def test_limits_themselves_are_allowed_and_a_value_that_is_not_given():
    example = Example(size_m=2.0, count=9, region=(0, 0, 0, 1, 1, 1))
    assert (example.count, Example().count, Example().rest) == (9, None, {})
    limits = {f.name: f.metadata.get("limits") for f in dataclasses.fields(Example)}
    assert limits["count"] == Meta(ge=1, le=9)
