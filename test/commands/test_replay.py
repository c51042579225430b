# SPDX-License-Identifier: Apache-2.0
"""``needle_sim replay`` and ``needle_sim salvage`` as they are called."""

import json

import numpy as np
import pytest
from mcap.writer import Writer

from needle_sim_ros.cli import main
from needle_sim_ros.session.compare import UNITS
from needle_sim_ros.session.content import read_content
from needle_sim_ros.session.reader import read_session


def replayed(bag, folder, *options):
    status = main(["replay", str(bag), "--json", str(folder / "replay.json"), *options])
    return status, json.loads((folder / "replay.json").read_text())


def test_an_own_session_replays_without_any_difference(recorded, tmp_path, capsys):
    status, result = replayed(recorded / "bag", tmp_path, "--plot", str(tmp_path / "both.svg"))
    assert status == 0
    assert set(result["channels"]) == set(UNITS)
    for name, entry in result["channels"].items():
        assert (entry["max_abs"], entry["rms"], entry["unit"]) == (0.0, 0.0, UNITS[name])
    assert result["ticks_compared"] == result["ticks"] > 100
    assert result["beyond_tolerance"] == [] and result["ticks_held"] == 0
    assert "base_force" in capsys.readouterr().out
    assert "simulated" in (tmp_path / "both.svg").read_text()


def test_another_tissue_differs_and_the_tolerance_decides(recorded, coarse, tmp_path):
    softer = ("--set", "tissue.youngs_modulus=12000")
    status, result = replayed(recorded / "bag", tmp_path, *softer)
    force = result["channels"]["base_force"]
    assert status == 1 and "base_force" in result["beyond_tolerance"]
    assert 0 < force["rms"] < force["max_abs"]
    assert result["channels"]["base_position"]["max_abs"] == 0.0  # the motion is the same
    enough = str(2 * force["max_abs"])
    status, result = replayed(
        recorded / "bag",
        tmp_path,
        *softer,
        "--tolerance",
        "1",
        "--tolerance",
        f"base_force={enough}",
    )
    assert status == 0 and result["beyond_tolerance"] == []


def test_differences_of_rounding_are_told_from_others(recorded, tmp_path):
    modulus = read_session(recorded / "bag").scene().tissue.youngs_modulus
    results = []
    for factor in (1 + 1e-13, 1.01):
        changed = f"tissue.youngs_modulus={modulus * factor!r}"
        status, result = replayed(recorded / "bag", tmp_path, "--set", changed)
        assert status == 1 and result["beyond_tolerance"]
        results.append(any("--tolerance 1e-09 takes them" in note for note in result["notes"]))
    assert results == [True, False]


def test_differences_are_those_of_the_series(recorded, tmp_path):
    out = tmp_path / "both"
    softer = ("--set", "tissue.youngs_modulus=12000")
    _, result = replayed(recorded / "bag", tmp_path, *softer, "--output", str(out))
    content = read_content(next(out.glob("*.mcap")))
    wrenches = [
        np.array(
            [data[-48:] for *_, data in content.of_topic(topic, "geometry_msgs/msg/WrenchStamped")]
        )
        for topic in ("/base_wrench", "/replay/base_wrench")
    ]
    ours, theirs = (np.array([np.frombuffer(row, "<f8")[:3] for row in w]) for w in wrenches)
    assert len(ours) == len(theirs) == result["ticks"]
    assert result["channels"]["base_force"]["max_abs"] == np.abs(ours - theirs).max() > 0
    session = read_session(out)  # still the recorded session
    np.testing.assert_array_equal(session.series.base_force, ours)


def test_a_scene_that_the_motion_misses_is_refused(recorded, tmp_path, capsys):
    protocol = "protocol=[{duration: 29.7, velocity: [0, 0, -0.03]}]"  # this one would reach it
    higher = ["--set", "base.position=[0, 0, 1.0]", "--set", protocol]
    assert main(["replay", str(recorded / "bag"), *higher]) == 2
    assert "never reaches the tissue" in capsys.readouterr().err


def empty_mcap(path, topic=None):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        if topic:
            schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
            channel = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channel, 1, b"\x00\x01\x00\x00" + bytes(8), 1)
        writer.finish()
    return path


@pytest.mark.parametrize("kind", ["text", "none", "empty", "foreign", "tolerance", "no_commands"])
def test_bad_input_is_one_line(kind, tmp_path, recorded, capsys):
    text = tmp_path / "text.mcap"
    text.write_text("no bag at all, only text\n")
    session = tmp_path / "session"
    given, words = {
        "text": ([text], "not an MCAP file"),
        "none": ([tmp_path / "nothing"], "no such session"),
        "empty": ([empty_mcap(tmp_path / "e.mcap")], "the bag is empty"),
        "foreign": ([empty_mcap(tmp_path / "f.mcap", "/x")], "it is no session of needle_sim"),
        "tolerance": ([recorded / "bag", "--tolerance", "force=1"], "the channels are"),
        "no_commands": ([session], "no command topic"),
    }[kind]
    if kind == "no_commands":
        from needle_sim_ros.scene import Scene
        from needle_sim_ros.session.writer import SessionWriter

        assert not SessionWriter(session, Scene.load("gao2016"), 0.01).close().error
    assert main(["replay", *map(str, given)]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_a_cut_session_is_salvaged_and_what_is_left_replays(recorded, tmp_path, capsys):
    (file,) = (recorded / "bag").glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:-2000])
    assert main(["salvage", str(cut), "--json", str(tmp_path / "s.json")]) == 0
    out = capsys.readouterr().out
    assert "cut off" in out or "not finished" in out
    result = json.loads((tmp_path / "s.json").read_text())
    assert result["bag"] == str(tmp_path / "cut_salvaged")
    assert result["has_scene"] and result["losses"] and result["messages"] > 1000
    status, replay = replayed(result["bag"], tmp_path)
    assert status == 0 and replay["ticks_compared"] > 100
    assert main(["salvage", str(cut)]) == 0  # the first result is not touched
    assert (tmp_path / "cut_salvaged_2").is_dir()


def test_a_lost_stretch_of_commands_is_held_and_said(recorded, tmp_path):
    session = read_session(recorded / "bag")
    from needle_sim_ros.session.replay import replay_ticks

    whole = replay_ticks(session)
    del session.motions[50:60]
    ticks = replay_ticks(session)
    assert len(ticks) == len(whole)
    assert [k for k, tick in enumerate(ticks) if tick.held] == list(range(50, 60))
    assert {tick.motion for tick in ticks[50:60]} == {whole[49].motion}


def test_salvage_of_what_is_no_mcap_file_is_one_line(tmp_path, capsys):
    path = tmp_path / "text.mcap"
    path.write_text("no bag at all, only text\n")
    assert main(["salvage", str(path)]) == 2
    assert "not an MCAP file" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["text.mcap"]
