"""Files made to be too much or of other types: one line, a documented exit code, in bounded time."""

import hashlib
import json
import re
import shutil
import time
import zipfile
from pathlib import Path

import pytest
from mcap.writer import Writer

from alula.cli.main import run

DEEP = '{"a":' * 5000 + "1" + "}" * 5000


def refused(words, capsys, codes=(2, 3)) -> str:
    begin = time.process_time()
    code = run(words)
    assert time.process_time() - begin < 10
    said = capsys.readouterr().err
    assert code in codes, said
    assert said.count("\n") == 1
    assert "internal error" not in said
    return said


@pytest.mark.parametrize(
    "text",
    [
        ".".join(["a"] * 20_000) + " = 1",
        "[" + ".".join(["a"] * 20_000) + "]",
        "a = { " + ".".join(['"b"'] * 10_000) + " = 1 }",
        "a = " + "[" * 50_000 + "]" * 50_000,
        "a = " + "{ b = " * 20_000 + "1" + "}" * 20_000,
        "a = " + "9" * 100_000,
    ],
    ids=["dotted", "header", "inline", "arrays", "tables", "digits"],
)
def test_toml_that_would_take_the_parser_long(tmp_path, capsys, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    assert "is not TOML" in refused(["info", str(path)], capsys)
    refused(["simulate", str(path), "-o", str(tmp_path / "o.run.mcap")], capsys)


def edited(source: Path, path: Path, edit) -> Path:
    """A copy of an artifact with another text of its manifest."""
    with zipfile.ZipFile(source) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    members["manifest.json"] = edit(json.loads(members["manifest.json"])).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, raw in members.items():
            archive.writestr(name, raw)
    return path


def test_a_deep_manifest(pipeline, tmp_path, capsys):
    deep = lambda manifest: json.dumps(manifest).replace('"summary": {', '"summary": {"z": ' + DEEP + ", ", 1)  # noqa: E731
    for kind in ("scene", "voxels", "cover", "plan"):
        path = edited(pipeline / f"tiny.{kind}.npz", tmp_path / "a.npz", deep)
        assert "64 levels" in refused(["info", str(path)], capsys, codes=(3,))


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        ("scene", "source", {"removed": {"min_opacity": "many"}}),
        ("scene", "source", {"removed": [1, 2]}),
        ("scene", "source", {"loss": {"unbounded": {"x": 3}}}),
        ("scene", "source", {"loss": {"opacity": "much"}}),
        ("scene", "alignment", {"position_error_m": "far"}),
        ("cover", "certificate", {"curve": {"hulls": ["a"], "excess_sum_voxels": [1], "half_planes": [1]}}),
        ("cover", "certificate", {"curve": {"hulls": [1, 2], "excess_sum_voxels": [1], "half_planes": [1]}}),
        ("cover", "certificate", {"curve": {"hulls": [1e300], "excess_sum_voxels": [1], "half_planes": [1]}}),
        ("cover", "conservativeness", -1),
        ("plan", "radius_m", 1e300),
    ],
)
def test_entries_of_manifests_of_another_type(pipeline, tmp_path, capsys, kind, key, value):
    path = edited(
        pipeline / f"tiny.{kind}.npz",
        tmp_path / "a.npz",
        lambda manifest: json.dumps(manifest | {key: value}),
    )
    assert key in refused(["info", str(path)], capsys, codes=(3,))
    words = ["report", f"--{kind}", str(path), "-o", str(tmp_path / "o.html")]
    refused(words, capsys, codes=(3,))
    assert [one.name for one in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize(
    "edit",
    [
        lambda tree: [],
        lambda tree: tree | {"checks": 3},
        lambda tree: tree | {"checks": [3]},
        lambda tree: tree | {"left_out": [1]},
        lambda tree: tree | {"covered": "yes"},
        lambda tree: tree | {"covered": not tree["covered"]},
        lambda tree: tree | {"version": "9.0"},
        lambda tree: tree | {"version": "new"},
        lambda tree: tree | {"provenance": 1},
    ],
)
def test_certificates_of_other_types(pipeline, tmp_path, capsys, edit):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(edit(json.loads((pipeline / "tiny.certificate.json").read_text()))))
    words = ["report", "--certificate", str(path), "--cover", str(pipeline / "tiny.cover.npz")]
    assert "certificate" in refused([*words, "-o", str(tmp_path / "o.html")], capsys, codes=(3,))


def test_a_deep_certificate(pipeline, tmp_path, capsys):
    path = tmp_path / "a.json"
    path.write_text((pipeline / "tiny.certificate.json").read_text().replace("{", '{"z": ' + DEEP + ",", 1))
    words = ["report", "--certificate", str(path), "--cover", str(pipeline / "tiny.cover.npz")]
    refused([*words, "-o", str(tmp_path / "o.html")], capsys, codes=(3,))
    refused(["info", str(path)], capsys, codes=(3,))


@pytest.mark.parametrize("topic", ["/state", "/safety", "/supervisor", "/log", "/map"])
def test_a_log_with_a_deep_message(pipeline, tmp_path, capsys, topic):
    from alula.schemas.log.mcap import entries

    path = tmp_path / "a.run.mcap"
    with (pipeline / "tiny.run.mcap").open("rb") as file:
        notes = [(name, data) for kind, name, data in entries(file) if kind == "metadata"]
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="alula")
        channel = writer.register_channel(topic, "json", writer.register_schema("a", "jsonschema", b"{}"))
        writer.add_message(channel, 0, DEEP.encode(), 0)
        for name, data in notes:
            writer.add_metadata(name, data)
        writer.finish()
    assert re.search("truncated or corrupt", refused(["report", str(path), "-o", f"{path}.html"], capsys))


def test_a_plan_of_a_century(pipeline, tmp_path, capsys):
    import io

    import numpy as np

    source, path = pipeline / "tiny.plan.npz", tmp_path / "a.plan.npz"
    with zipfile.ZipFile(source) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    time_s = np.load(io.BytesIO(members["time.npy"])).copy()
    time_s[-1] = 3e9
    data = io.BytesIO()
    np.lib.format.write_array(data, time_s, version=(1, 0))
    members["time.npy"] = data.getvalue()
    manifest = json.loads(members["manifest.json"])
    manifest["arrays"]["time"]["sha256"] = hashlib.sha256(time_s.tobytes()).hexdigest()
    members["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, raw in members.items():
            archive.writestr(name, raw)
    words = [
        "simulate",
        str(path),
        "--map",
        str(pipeline / "tiny.cover.npz"),
        "-o",
        str(tmp_path / "o.run.mcap"),
    ]
    assert "beyond 10000 in row" in refused(words, capsys, codes=(3,))


@pytest.mark.slow
def test_a_sparse_json_file_is_not_read_whole(tmp_path, capsys):
    path = Path(shutil.copy(__file__, tmp_path / "a.json"))
    with path.open("r+b") as file:
        file.truncate(2**33)
    refused(["info", str(path)], capsys, codes=(3,))
