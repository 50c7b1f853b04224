"""The layouts for Foxglove and PlotJuggler name what a recording and its export hold."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mcap.reader import make_reader
from sawbench.storage.schemas.preview_pb2 import Preview
from sawbench.storage.schemas.sample_block_pb2 import SampleBlock

pytestmark = pytest.mark.contract

ROOT = Path(__file__).parents[2]
LAYOUTS = ROOT / "docs" / "layouts"
FIELDS = {
    "preview": {field.name for field in Preview.DESCRIPTOR.fields},
    "signals": {field.name for field in SampleBlock.DESCRIPTOR.fields},
}


@pytest.fixture(scope="module")
def topics():
    with (ROOT / "recordings" / "oak-01.mcap").open("rb") as file:
        return {channel.topic for channel in make_reader(file).get_summary().channels.values()}


def panels_of(layout):
    """Names of the panels of a tree of splits."""
    if isinstance(layout, str):
        return [layout]
    assert layout["direction"] in {"row", "column"}
    assert 0 < layout["splitPercentage"] < 100
    return panels_of(layout["first"]) + panels_of(layout["second"])


def test_the_foxglove_layout_shows_every_panel_once_and_topics_that_exist(topics):
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert sorted(panels_of(layout["layout"])) == sorted(layout["configById"])
    shown = set()
    for name, config in layout["configById"].items():
        if name.startswith("RawMessages!"):
            assert config["topicPath"] in topics
            continue
        assert config["xAxisVal"] in {"timestamp", "index"}
        for path in config["paths"]:
            topic, field = re.fullmatch(r"(/\w+/\w+)\.(\w+)(?:\[:\])?", path["value"]).groups()
            assert topic in topics
            assert field in FIELDS[topic.split("/")[1]]
            shown.add(topic)
    assert {one for one in topics if one.startswith("/preview/")} <= shown


def test_the_plotjuggler_layout_names_exported_columns_and_topics_that_exist(topics):
    channels = {one.removeprefix("/signals/") for one in topics if one.startswith("/signals/")}
    full, overview = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot().find("tabbed_widget").findall("Tab")
    assert {curve.get("name") for curve in full.iter("curve")} == channels
    for curve in overview.iter("curve"):
        topic, _, field = curve.get("name").rpartition("/")
        assert topic in topics
        assert field in FIELDS["preview"]
    for splitter in (*full.iter("DockSplitter"), *overview.iter("DockSplitter")):
        assert int(splitter.get("count")) == len(splitter.get("sizes").split(";")) == len(list(splitter))
