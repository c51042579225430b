# SPDX-License-Identifier: Apache-2.0
"""``needle_sim plot``: from the recording alone."""

import json
import shutil
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from needle_sim_ros.cli import main
from needle_sim_ros.commands.session_plot import _section
from needle_sim_ros.session.reader import read_session


def test_plot_of_a_recording(recorded, tmp_path, capsys):
    output, result = tmp_path / "new" / "session.svg", tmp_path / "plot.json"
    arguments = [f"{recorded}/bag", "--output", f"{output}", "--json", f"{result}"]
    assert main(["plot", *arguments]) == 0
    assert "<svg" in output.read_text()
    assert str(output) in capsys.readouterr().out
    run = json.loads((recorded / "out.json").read_text())["summary"]
    summary = json.loads(result.read_text())["summary"]
    for name in ("peak_base_force_n", "puncture_force_n", "max_tip_deflection_m", "ticks"):
        assert summary[name] == run[name], name
    assert summary["tick_median_s"] is None  # a recording does not tell


def test_the_section_is_the_recorded_one_simulated_again(recorded):
    session = read_session(recorded / "bag")
    section, note = _section(session)
    assert "0 µm from the recorded one" in note
    row = int(np.argmin(np.abs(session.series.time - section.time)))
    assert session.series.process[row : row + 2] == ["insertion", "hold"]
    assert np.allclose(section.needle[-1], session.series.tip_position[row], atol=1e-12)
    assert np.allclose(section.markers, session.series.marker_positions[row], atol=1e-8)


def test_a_recording_cut_off_is_drawn_as_far_as_it_goes(tmp_path):
    cut = tmp_path / "cut.mcap"
    whole = next((Path(__file__).parents[2] / "bags" / "gao2016").glob("*.mcap"))
    with whole.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    middle = chunks[len(chunks) // 2]
    cut.write_bytes(whole.read_bytes()[: middle.chunk_start_offset + middle.chunk_length // 2])
    result = tmp_path / "cut.json"
    assert main(["plot", f"{cut}", "--output", f"{tmp_path}/cut.png", "--json", f"{result}"]) == 0
    ticks = json.loads(result.read_text())["summary"]["ticks"]
    assert 1000 < ticks < 1700  # of 2700


def test_what_is_no_session_is_an_error(tmp_path, capsys):
    empty, other = tmp_path / "empty", tmp_path / "other.mcap"
    empty.mkdir()
    other.write_bytes(b"not an MCAP file" * 50)
    for bag in (empty, other, tmp_path / "missing"):
        assert main(["plot", f"{bag}", "--output", f"{tmp_path}/a.png"]) == 2
        error = capsys.readouterr().err
        assert str(bag) in error and error.count("\n") == 1
    assert not (tmp_path / "a.png").exists()
    shutil.rmtree(empty)
