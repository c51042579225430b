# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove are set up to show exists, under the names that are published."""

import importlib
import json
import re
from pathlib import Path

import pytest
import yaml

from needle_sim_ros.session import channels
from needle_sim_ros.view.shapes import Shapes

CONFIG = Path(__file__).resolve().parents[2] / "config"
FOXGLOVE = json.loads((CONFIG / "foxglove/needle_sim.json").read_text())
RVIZ = yaml.safe_load((CONFIG / "rviz/needle_sim.rviz").read_text())
TYPES = {f"/{c.name}".replace("//", "/"): c.type for c in (*channels.OUTPUTS, *channels.RECORDS)}
TYPES |= {
    "/visualization": "visualization_msgs/msg/MarkerArray",
    "/needle_shape": "nav_msgs/msg/Path",
    "/predicted_tip_path": "nav_msgs/msg/Path",
}


def test_rviz_shows_topics_of_the_type_that_its_displays_take():
    manager = RVIZ["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "tissue"
    displays = [display for display in manager["Displays"] if "Topic" in display]
    assert displays[0]["Topic"]["Value"] == "/visualization"
    for display in displays:
        kind = display["Class"].split("/")[1]
        published = TYPES[display["Topic"]["Value"]].split("/")[-1]
        assert published.removesuffix("Stamped") == kind


def test_rviz_names_every_shape(drawn_shapes):
    manager = RVIZ["Visualization Manager"]
    assert set(manager["Displays"][1]["Namespaces"]) == drawn_shapes


@pytest.fixture
def drawn_shapes(simulator):
    sim = simulator()
    return {s.name for s in Shapes(sim.scene).of(sim.observe(), sim.tissue_displacement)}


def test_foxglove_shows_topics_and_fields_that_exist():
    pytest.importorskip("rclpy")
    panels = FOXGLOVE["configById"]
    assert set(panels["3D!scene"]["topics"]) <= set(TYPES)
    assert panels["DiagnosticSummary!node"]["topicToRender"] in TYPES
    paths = [p["value"] for panel in panels.values() for p in panel.get("paths", [])]
    for path in [*paths, panels["RawMessages!process"]["topicPath"]]:
        topic, *fields = path.split(".")
        package, _, kind = TYPES[topic].split("/")
        value = getattr(importlib.import_module(f"{package}.msg"), kind)()
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, (float, str))


def test_every_foxglove_panel_is_laid_out():
    placed = set(re.findall(r'"(\w+!\w+)"', json.dumps(FOXGLOVE["layout"])))
    assert placed == set(FOXGLOVE["configById"])
