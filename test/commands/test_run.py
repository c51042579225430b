# SPDX-License-Identifier: Apache-2.0
"""``needle_sim run``: JSON, summary, recording, picture, pace."""

import json
import time

import numpy as np
import pytest

from needle_sim_ros.cli import main
from needle_sim_ros.commands import run as run_command
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.reader import read_session

_LAWS = Scene.load("gao2016").interaction
_SERIES = {
    "time": (),
    "insertion_depth": (),
    "base_force": (3,),
    "tip_force": (),
    "friction_force": (),
    "tip_position": (3,),
    "tip_deflection": (3,),
    "marker_positions": (2, 3),
}


@pytest.fixture
def out(recorded):
    return json.loads((recorded / "out.json").read_text())


def test_json_has_the_documented_keys_and_shapes(out):
    assert set(out) == {"scene", "ticks", "summary", "series"}
    assert out["scene"] == "gao2016"
    assert out["ticks"] == 334  # 6.67 s by 0.02 s
    assert set(out["series"]) == {*_SERIES, "process"}
    for name, shape in _SERIES.items():
        assert np.shape(out["series"][name]) == (334, *shape), name
    assert len(out["series"]["process"]) == 334
    assert out["series"]["time"][:2] == [0.02, 0.04]


def test_json_never_has_nan(recorded):
    def refuse(constant):
        raise AssertionError(constant)

    json.loads((recorded / "out.json").read_text(), parse_constant=refuse)


def test_force_curve_has_the_segments_of_fig_3(out):
    series = out["series"]
    force = -np.array(series["base_force"])[:, 2]
    process = np.array(series["process"])
    order = [name for name, _ in zip(*np.unique(process, return_index=True), strict=True)]
    assert set(order) == {"free", "contact", "insertion", "hold", "retraction"}
    contact, insertion = force[process == "contact"], force[process == "insertion"]
    hold, retraction = force[process == "hold"], force[process == "retraction"]
    assert (np.diff(contact) > 0).all()
    puncture = max(contact[-1], insertion[0])
    assert puncture == pytest.approx(_LAWS.puncture.force, rel=0.02)
    assert insertion[:15].min() < 0.95 * puncture  # the force falls once the surface breaks
    depth = np.array(series["insertion_depth"])[process == "insertion"]
    deep = depth > 0.01
    slope, offset = np.polyfit(depth[deep], insertion[deep], 1)
    assert np.abs(insertion[deep] - slope * depth[deep] - offset).max() < 0.02 * insertion.max()
    assert slope == pytest.approx(_LAWS.friction.kinetic, rel=0.05)
    assert (np.diff(hold) <= 1e-9).all() and hold[-1] < 0.9 * hold[0]
    assert retraction.min() < -0.5 * insertion.max()
    assert abs(force[-1]) < 1e-9


def test_summary_says_what_the_series_say(out):
    summary, series = out["summary"], out["series"]
    force = np.linalg.norm(series["base_force"], axis=1)
    process = np.array(series["process"])
    for name, peak in summary["peak_base_force_n"].items():
        assert peak == force[process == name].max()
    assert summary["puncture_force_n"] == pytest.approx(_LAWS.puncture.force, rel=0.02)
    broken = np.flatnonzero(process == "insertion")[0]
    assert summary["puncture_force_n"] == force[broken]
    assert summary["puncture_depth_m"] == -series["tip_position"][broken][2] > 1e-3
    deflection = np.linalg.norm(series["tip_deflection"], axis=1).max()
    assert summary["max_tip_deflection_m"] == deflection > 1e-4
    moved = np.array(series["marker_positions"]) - [[0.005, 0, -0.01], [-0.01, 0, -0.04]]
    assert summary["max_marker_displacement_m"] == pytest.approx(
        np.linalg.norm(moved, axis=2).max(), rel=1e-9
    )
    assert summary["ticks"] == 334
    assert 0 < summary["tick_median_s"] <= summary["tick_p99_s"]
    assert summary["duration_s"] == pytest.approx(6.68)
    assert summary["real_time_factor"] > 0


def test_the_recording_holds_what_the_json_says(recorded, out):
    session = read_session(recorded / "bag")
    assert session.complete
    series = session.series
    assert np.allclose(series.time, out["series"]["time"], rtol=0, atol=1e-9)
    for name in ("base_force", "tip_force", "friction_force", "tip_position", "insertion_depth"):
        assert getattr(series, name).tolist() == out["series"][name], name
    assert series.process == out["series"]["process"]


def test_the_table_is_for_people(coarse, capsys, tmp_path):
    short = ["--set", "protocol=[{duration: 0.36, velocity: [0, 0, -0.03]}]"]
    picture = tmp_path / "contact.png"
    assert main(["run", "gao2016", *coarse, *short, "--plot", f"{picture}"]) == 0
    assert picture.stat().st_size > 10_000
    printed = capsys.readouterr()
    for words in ("peak base force, contact", "tick, median", "real-time factor", " N", " mm"):
        assert words in printed.out
    assert "puncture" not in printed.out  # it did not come to that
    assert "\033" not in printed.out and "\033" not in printed.err
    assert printed.err.startswith("tissue: ") and len(printed.err.splitlines()) == 1


def test_the_picture_is_there(recorded):
    assert (recorded / "out.png").read_bytes().startswith(b"\x89PNG")


def test_an_existing_recording_is_never_overwritten(recorded, coarse, capsys):
    before = {path: path.read_bytes() for path in (recorded / "bag").iterdir()}
    assert main(["run", "gao2016", *coarse, "--record", f"{recorded}/bag"]) == 2
    assert "exists" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in (recorded / "bag").iterdir()} == before


def test_realtime_takes_as_long_as_it_simulates(coarse, capsys):
    short = ["--set", "protocol=[{duration: 0.6, velocity: [0, 0, -0.03]}]"]
    begin = time.perf_counter()
    assert main(["run", "gao2016", *coarse, *short, "--realtime", "--json", "/dev/null"]) == 0
    assert time.perf_counter() - begin > 0.6
    row = next(r for r in capsys.readouterr().out.splitlines() if "real-time factor" in r)
    assert float(row.split()[-1]) <= 1.01


def test_a_recording_faster_than_the_disk_waits_for_it(coarse, tmp_path, monkeypatch):
    monkeypatch.setattr(run_command, "_QUEUE", 200)
    short = ["--set", "protocol=[{duration: 1.0, velocity: [0, 0, -0.03]}]"]
    assert main(["run", "gao2016", *coarse, *short, "--record", f"{tmp_path}/bag"]) == 0
    assert len(read_session(tmp_path / "bag").series) == 50
