"""Every filter parameter has one source, and all that follows from it is current."""

import shutil
import site
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.schemas.generate import PAGES, filter_files
from alula.schemas.parameters.filter_options import FILTERS, NATIVE_NAMES, NATIVE_STRUCTS
from alula.schemas.parameters.filters import source
from alula.schemas.parameters.filters.values import complaint, defaults, entries
from alula.stages.filtering.moving_filters import native_options
from support.paths import ROOT

NAMES = (
    *("none", "polytope-cbf", "safer-splat", "cone-di", "cone-ecbf", "cone-backup", "shield"),
    *("dr-acbf", "dr-acbf-qp", "cbf-qp", "rp-cbf", "mpc", "geofence", "backup-qp"),
)


@pytest.mark.parametrize("name", filter_files(ROOT))
def test_generated_files_are_current(name):
    assert (ROOT / name).read_text() == filter_files(ROOT)[name], "run make schemas"


def test_every_filter_has_parameters_and_each_of_them_documentation():
    assert set(FILTERS) == set(NAMES)
    for options in FILTERS.values():
        for name, entry in entries(options).items():
            assert len(entry.meta.description or "") > 8, name
            assert entry.default is None or complaint(entry, entry.default) is None, name


def test_no_two_parts_of_a_filter_have_a_parameter_of_the_same_name():
    for struct in source.load(ROOT / "schemas/parameters/filters").values():
        names = [parameter.name for parameter in struct.public()]
        assert len(names) == len(set(names)), struct.name


def changed(tmp_path, *edits):
    """A scratch tree whose parameter source has other defaults, with all that is generated from it."""
    for folder in ("native/core/include/alula/filters", "native/onboard/include", "docs/theory", "alula"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copytree(ROOT / "schemas", tmp_path / "schemas", ignore=shutil.ignore_patterns("__pycache__"))
    for page in PAGES:
        shutil.copy(ROOT / page, tmp_path / page)
    for file, old, new in edits:
        path = tmp_path / "schemas/parameters/filters" / file
        text = path.read_text()
        assert text.count(old) == 1
        path.write_text(text.replace(old, new))
    package = {"schemas": tmp_path / "schemas", "cli": ROOT / "cli", "stages": ROOT / "stages"}
    package |= {"__init__.py": ROOT / "native/python/alula/__init__.py"}
    package |= {Path(_core.__file__).name: Path(_core.__file__)}
    for name, target in package.items():
        (tmp_path / "alula" / name).symlink_to(target)
    run(tmp_path, "alula.schemas.generate", tmp_path)
    return tmp_path


def run(tree, module, *words):
    """Output of a module of a scratch tree; without `site`, which would find the installed package first."""
    folders = [str(tree), *site.getsitepackages()]
    code = f"import runpy, sys; sys.path[:0] = {folders!r}; sys.argv = sys.argv[1:]; "
    code += "runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
    command = [sys.executable, "-S", "-P", "-B", "-c", code, module, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tree)
    assert done.returncode == 0, done.stderr
    return " ".join(done.stdout.split())


def test_one_changed_default_is_found_everywhere(tmp_path):
    tree = changed(
        tmp_path,
        ("polytope-cbf.toml", "default = 2.0\n", "default = 2.625\n"),
        ("cone-di.toml", "default = 0.01\n", "default = 0.0375\n"),
        ("geofence.toml", "default = 1.5\n", "default = 1.75\n"),
        ("avoidance.toml", "default = 1.645\n", "default = 1.875\n"),
    )
    cpp = (tree / "native/core/include/alula/filters/options.hpp").read_text()
    c = (tree / "native/onboard/include/alula_options.h").read_text()
    assert "double beta = 2.625;" in cpp
    assert "double swell = 0.0375;" in cpp
    assert all(f".{text}F," in c for text in ("beta = 2.625", "beta = 1.75", "simple_quantile = 1.875"))
    assert "| `beta` | 2.625 | 1/s |" in (tree / "docs/theory/filters.md").read_text()
    assert "| `swell` | 0.0375 |" in (tree / "docs/theory/filters.md").read_text()
    assert "| `beta` | 1.75 | 1/s |" in (tree / "docs/theory/geofence.md").read_text()
    assert "| `simple_quantile` | 1.875 |" in (tree / "docs/theory/moving.md").read_text()

    def in_schema(struct, parameter):
        raw = (tree / "schemas/json/alula-scenario-2.0.schema.json").read_bytes()
        return msgspec.json.decode(raw)["$defs"][struct]["properties"][parameter]["default"]

    assert in_schema("PolytopeCbfParameters", "beta") == 2.625
    assert in_schema("ConeDiParameters", "swell") == 0.0375
    assert in_schema("GeofenceParameters", "beta") == 1.75
    assert in_schema("MovingFilterParameters", "simple_quantile") == 1.875

    (tree / "ask.py").write_text(
        "from alula.schemas.parameters.filter_options import FILTERS, NATIVE_NAMES\n"
        "from alula.stages.filtering.registry import complete_parameters\n"
        "from alula.stages.filtering.moving_filters import native_options\n"
        "print(FILTERS['polytope-cbf']().beta, FILTERS['geofence']().beta,"
        " complete_parameters('cone-di', {})['swell'], native_options(FILTERS['mpc']())['simple_quantile'])\n"
    )
    assert run(tree, "ask") == "2.625 1.75 0.0375 1.875"
    assert "[default: 2.625]" in run(tree, "alula.cli.main", "fly", "--help-all")
    keys = run(tree, "alula.cli.main", "scenario", "--keys", "safety.polytope-cbf")
    assert "safety.polytope-cbf.beta = 2.625" in keys


@pytest.mark.parametrize("name", NATIVE_STRUCTS)
def test_native_defaults_are_those_of_python(name):
    known, own = defaults(FILTERS[name]), getattr(_core, NATIVE_STRUCTS[name][0].native)()
    names = NATIVE_NAMES.get(name, {})
    compared = set()
    for part in NATIVE_STRUCTS[name]:
        if part.argument and hasattr(own, part.argument):
            native = getattr(own, part.argument)
        else:
            native = getattr(_core, part.native)()
        for key in part.names:
            if key in known:
                assert getattr(native, names.get(key, key)) == known[key], key
                compared.add(key)
    assert known.keys() - compared <= {"solver", "policy", "onboard", "shield_map"}


def test_native_defaults_of_filters_among_moving_obstacles_are_those_of_python():
    native = _core.moving_filter_defaults()
    known = native_options(FILTERS["dr-acbf"]())
    vehicle = {"dt_s", "radius_m", "a_max", "v_max", "j_max", "wall_deceleration"}
    assert native.keys() - known.keys() == vehicle
    for name, value in known.items():
        assert native[name] == (value if name.startswith(("mpc_", "cbf_", "rp_")) else np.float32(value)), (
            name
        )


def test_native_defaults_of_the_geofence_are_those_of_python():
    known = defaults(FILTERS["geofence"])
    geofence = _core.Geofence(_core.Fence(box=((-1, -1, -1), (1, 1, 1))))
    assert _core.BackupQp(geofence).alpha == known.pop("alpha")
    native = geofence.parameters
    assert native.pop("radius_m") == 0
    assert native == {name: np.float32(value) for name, value in known.items()}


def test_native_options_refuse_what_they_do_not_know():
    with pytest.raises(TypeError, match=r"Pruning has no counts; it has reaction_time_s, .*count"):
        _core.Pruning(counts=3)
    with pytest.raises(TypeError, match="Pruning: count must be int, not 'many'"):
        _core.Pruning(count="many")
    with pytest.raises(TypeError, match="Quadrotor needs mass"):
        _core.Quadrotor()
    with pytest.raises(ValueError, match=r"alpha must be above 0, not -1"):
        _core.ConeDiOptions(alpha=-1)
    with pytest.raises(ValueError, match="hessian must be correct or published, not 'none'"):
        _core.SaferSplatOptions(hessian="none")
    with pytest.raises(ValueError, match="eta_frac must be below 1, not 1"):
        _core.BackupGains(eta_frac=1)


def test_a_value_beyond_its_limits_is_refused_with_the_limit():
    known = entries(FILTERS["cone-ecbf"])
    assert complaint(known["lambda_"], 0) == "must be above 0, not 0"
    assert complaint(known["least_thrust"], 1.0) == "must be at least 0 and below 1, not 1"
    assert complaint(known["count"], -1) == "must be a whole number from 0 to 2147483647, not -1"
    assert complaint(known["weight"], [1, 2]) == "must be 4 numbers, not [1, 2]"
    assert complaint(known["gate"], 1) == "must be true or false, not 1"
    assert complaint(known["policy"], "stop").startswith("must be hover or heading-invariant or brake")
    assert complaint(known["lambda_"], 3) is None


def test_the_source_is_checked(tmp_path):
    def load(text):
        (tmp_path / "one.toml").write_text(f'[struct]\ndoc = "x"\n[a]\n{text}')
        source.load(tmp_path)

    load('default = 1.0\ndoc = "x"\nmin = 1')
    for text, wrong in (
        ('default = 1.0\ndoc = "x"\nabove = 1', "beyond its limits"),
        ('default = "c"\ndoc = "x"\nchoices = { a = "x" }', "not one of its choices"),
        ('default = 1.0\ndoc = "x"\nmaximum = 1', "unexpected keyword argument 'maximum'"),
    ):
        with pytest.raises(ValueError, match=f"one.toml: a: .*{wrong}"):
            load(text)


@pytest.mark.parametrize(
    ("defaults", "words"), [("{ wait_s = 2 }", "must be a float"), ("{ wait = 2.0 }", "no parameter wait")]
)
def test_a_default_of_a_part_has_the_type_that_the_part_gives_it(tmp_path, defaults, words):
    """A whole number would make an option that takes seconds refuse fractions."""
    (tmp_path / "gate.toml").write_text('[struct]\ndoc = "x"\n[wait_s]\ndefault = 0.3\ndoc = "x"\n')
    (tmp_path / "a.toml").write_text(f'[struct]\ndoc = "x"\n[parts.gate]\ndefaults = {defaults}\n')
    with pytest.raises(ValueError, match=words):
        source.load(tmp_path)
