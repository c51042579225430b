# SPDX-License-Identifier: Apache-2.0
"""CSV files as sessions that our reader and an independent one open."""

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from needle_sim_ros.cli import main
from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.csv_table import Column, read_columns, read_table
from needle_sim_ros.session.foreign import read_experiment
from needle_sim_ros.session.reader import read_session

TABLE = """# a robot's log
t;stage;Fz;bead x;bead z
1000;0;0.0;-10;-20
1100;0.5;-0.2;-10;-20
1250;1.25;;-9.9;-20.1
1400;2.0;-0.4;-9.8;-20.2
"""
COLUMNS = {
    "time": Column("t", "ms"),
    "base_position.z": Column("stage", "mm", -1.0, 0.14),
    "base_force.z": Column("Fz", "N"),
    "marker.1.x": Column("bead x", "mm"),
    "marker.1.z": Column("bead z", "mm"),
}


@pytest.fixture
def table(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text(TABLE)
    return file


def test_columns_become_quantities_in_si_units(table):
    found = read_table(table, COLUMNS)
    np.testing.assert_allclose(found["time"], [1.0, 1.1, 1.25, 1.4])
    np.testing.assert_allclose(found["base_position.z"], [0.14, 0.1395, 0.13875, 0.138])
    assert np.isnan(found["base_force.z"][2]) and found["base_force.z"][3] == -0.4


def test_headings_with_units_need_no_columns(tmp_path):
    file = tmp_path / "plain.csv"
    file.write_text("time [ms],base_position.z (mm),comment\n0,140,3\n10,139.9,4\n")
    found = read_table(file, {})
    assert set(found) == {"time", "base_position.z"}
    np.testing.assert_allclose(found["base_position.z"], [0.14, 0.1399])


def test_an_imported_file_is_a_session_for_both_readers(table, tmp_path):
    bag = tmp_path / "session"
    columns = tmp_path / "columns.yaml"
    columns.write_text(
        "time: {column: t, unit: ms}\n"
        "base_position.z: {column: stage, unit: mm, scale: -1.0, offset: 0.14}\n"
        "base_force.z: Fz\n"
    )
    options = ["--columns", str(columns), "--column", "marker.1.x=bead x:mm"]
    options += ["--rate", "50", "--column", "marker.1.z=bead z:mm", "--scene", "gao2016"]
    assert main(["import", str(table), "--output", str(bag), *options]) == 0
    session = read_session(bag)
    assert session.complete and len(session.motions) == 20  # 0.4 s of 0.02 s
    assert session.motions[-1][1].linear == pytest.approx((0.0, 0.0, 0.138))
    assert [role for _, role, _ in session.inputs] == ["base_pose"] * 4
    with AnyReader([bag]) as reader:
        topics = {c.topic: c.msgcount for c in reader.connections}
        poses = [c for c in reader.connections if c.topic == "/base_pose"]
        heights = [
            reader.deserialize(data, c.msgtype).pose.position.z
            for c, _, data in reader.messages(connections=poses)
        ]
    assert topics["/base_wrench"] == topics["/tissue_markers"] == 4
    np.testing.assert_allclose(heights, [0.14, 0.1395, 0.13875, 0.138])
    experiment = read_experiment(bag, None, None)
    np.testing.assert_allclose(experiment.measured["force"].time, [0, 0.1, 0.25, 0.4], atol=1e-9)
    moved = experiment.measured["markers"].values[:, 0]
    np.testing.assert_allclose(moved[-1] - moved[0], (2e-4, 0, -2e-4), atol=1e-8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,base_position.z\n0,1\n0.2,1\n0.1,1\n", "go backwards or stand still"),
        ("time,base_position.z\n0,1\n0.1,one\n", "row 2, column 'base_position.z': 'one'"),
        ("time,base_position.z\n0,1\n0.1\n", "row 2 has 1 cells: must be 2"),
        ("clock,base_position.z\n0,1\n1,1\n", "no column for the time"),
        ("time\n0\n", "at least two rows"),
        ("time,base_position.z [yd]\n0,1\n1,2\n", "unit 'yd' of base_position.z"),
    ],
)
def test_what_is_wrong_with_a_table_is_said(tmp_path, text, message):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(SessionError, match=message.replace("[", r"\[")):
        read_table(file, {})


def test_unknown_quantities_are_refused():
    with pytest.raises(SessionError, match=r"quantity 'base_force\.w'"):
        read_columns(None, ["base_force.w=F"])
    with pytest.raises(SessionError, match="QUANTITY=HEADING"):
        read_columns(None, ["base_force.x"])


def test_a_table_without_base_is_refused(tmp_path, capsys):
    file = tmp_path / "no_base.csv"
    file.write_text("time,base_force.z\n0,1\n1,2\n")
    assert main(["import", str(file), "--output", str(tmp_path / "x")]) == 2
    assert "base_position" in capsys.readouterr().err
