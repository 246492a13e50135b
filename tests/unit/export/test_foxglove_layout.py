"""Layouts for Foxglove: their panels have settings that foxglove-sdk knows, and show what a run has."""

import json

import msgspec
import pytest
from mcap.reader import make_reader

from alula.cli.main import run
from alula.schemas.log.channels import CHANNELS
from alula.schemas.log.foxglove import SceneUpdate
from alula.schemas.log.json_schema import json_schema
from alula.stages.export.foxglove_layout import contents, foxglove_layout
from alula.stages.runlog.messages import entity
from support.scenes.fabricate import make_record, make_trial, write_run

TITLE = {"foxglovePanelTitle"}


def paths_of(layout):
    return [each["value"] for panel in layout["configById"].values() for each in panel.get("paths", [])]


def leaves(node):
    if isinstance(node, str):
        return [node]
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    return [*leaves(node["first"]), *leaves(node["second"])]


def test_each_panel_is_placed_once():
    layout = foxglove_layout("world")
    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    assert len(layout["configById"]) == 6


def test_settings_of_panels_are_those_of_foxglove():
    layouts = pytest.importorskip("foxglove.layouts", reason="pip install 'alula[foxglove]'")
    known = {
        "3D": layouts.ThreeDeeConfig()._to_dict(),
        "Plot": layouts.PlotConfig(paths=[])._to_dict(),
        "StateTransitions": layouts.StateTransitionsConfig(paths=[])._to_dict(),
        "RosOut": layouts.LogConfig()._to_dict(),
    }
    for name, panel in foxglove_layout("world")["configById"].items():
        assert set(panel) - TITLE <= set(known[name.split("!")[0]]), name
    scene = foxglove_layout("world")["configById"]["3D!alula"]
    assert set(scene["cameraState"]) <= set(layouts.ThreeDeeCameraState()._to_dict())
    assert set(scene["layers"]["grid"]) <= set(layouts.BaseRendererGridLayerSettings()._to_dict())
    assert set(scene["topics"]["/splat"]) <= set(layouts.BaseRendererPointCloudTopicSettings()._to_dict())
    assert set(scene["topics"]["/path"]) <= set(layouts.BaseRendererPosesTopicSettings()._to_dict())


def test_all_paths_and_channels_of_the_full_layout_exist():
    layout = foxglove_layout("world")
    for path in paths_of(layout):
        topic, field, *modifier = path.split(".")
        properties = json_schema(CHANNELS[topic].struct)["properties"][field]
        assert modifier == (["@norm"] if properties.get("title") == "foxglove.Vector3" else [])
    assert set(layout["configById"]["3D!alula"]["topics"]) <= set(CHANNELS)
    assert layout["configById"]["RosOut!log"]["topicToRender"] in CHANNELS


def test_the_layout_of_a_run_shows_what_the_run_has(tmp_path, capsys):
    log, out = tmp_path / "r.run.mcap", tmp_path / "r.json"
    write_run(log, make_record([make_trial(0)]))
    assert run(["export", "--foxglove-layout", str(log), "-o", str(out), "-q"]) == 0
    with log.open("rb") as file:
        found = [(channel.topic, m.data) for _, channel, m in make_reader(file).iter_messages()]
    fields = {(topic, field) for topic, data in found for field in json.loads(data)}
    layout = json.loads(out.read_text())
    shown = {tuple(path.split(".")[:2]) for path in paths_of(layout)}
    assert shown <= fields
    every = {tuple(path.split(".")[:2]) for path in paths_of(foxglove_layout("world"))}
    assert shown == every & fields
    assert ("/safety", "h_m") in shown
    assert "RosOut!log" not in layout["configById"]
    assert layout["provenance"]["inputs"][0]["name"] == "r.run.mcap"
    assert run(["export", "--foxglove-layout", str(log), "-o", str(tmp_path / "r.layout")]) == 2
    assert ".json" in capsys.readouterr().err


def test_the_frame_is_that_of_the_map():
    message = msgspec.json.encode(SceneUpdate(entities=[entity("map", "site", 0)]))
    assert contents([("/map", message)]) == ("site", {"/map": {"deletions", "entities"}})
    assert foxglove_layout("site")["configById"]["3D!alula"]["fixedFrame"] == "site"
    assert foxglove_layout("site", {})["layout"] == "3D!alula"
