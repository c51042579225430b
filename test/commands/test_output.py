# SPDX-License-Identifier: Apache-2.0
"""JSON, tables, progress and early checks of what subcommands write."""

import io
import json
import sys

import numpy as np
import pytest

from needle_sim_ros.commands import output
from needle_sim_ros.commands.options import parse_overrides
from needle_sim_ros.commands.tables import summary_rows
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.session.summary import Summary


class Terminal(io.StringIO):
    """Text that believes to be a terminal."""

    def isatty(self):
        return True


def test_json_is_plain_and_has_no_nan(tmp_path):
    data = {
        "array": np.array([[1.5, np.nan], [np.inf, -2.0]]),
        "scalar": np.float64(0.5),
        "count": np.int64(3),
        "flag": np.bool_(True),
        "nested": [{"bad": float("-inf")}, ("a", None)],
        1: "number as key",
    }
    output.write_json(tmp_path / "new" / "a.json", data)
    assert json.loads((tmp_path / "new" / "a.json").read_text()) == {
        "array": [[1.5, None], [None, -2.0]],
        "scalar": 0.5,
        "count": 3,
        "flag": True,
        "nested": [{"bad": None}, ["a", None]],
        "1": "number as key",
    }
    output.write_json(None, data)  # not asked for


def test_table_lines_up():
    text = output.table([("a", "1.0"), ("longer", "20.0")], title="what", align="<>")
    assert text == "what\n  a        1.0\n  longer  20.0"


@pytest.mark.parametrize(("no_color", "bold"), [(False, True), (True, False)])
def test_colours_on_a_terminal_only(monkeypatch, no_color, bold):
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_color:
        monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(sys, "stdout", Terminal())
    assert ("\033[1m" in output.table([("a",)], title="t", align="<")) is bold
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    assert "\033" not in output.table([("a",)], title="t", align="<")


@pytest.mark.parametrize(
    ("stream", "delay", "shown"),
    [(Terminal, 0.0, True), (Terminal, 2.0, False), (io.StringIO, 0.0, False)],
)
def test_progress_on_a_terminal_and_on_long_work_only(monkeypatch, stream, delay, shown):
    written = stream()
    monkeypatch.setattr(sys, "stderr", written)
    monkeypatch.setattr(output, "PROGRESS_DELAY", delay)
    with output.progress(3, "working") as bar:
        for _ in range(3):
            bar.update()
    assert ("working" in written.getvalue()) is shown


def test_early_checks_make_nothing_they_should_not(tmp_path):
    output.check_new_folder(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []
    output.check_writable(tmp_path / "a" / "out.json")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_overrides_are_yaml_with_numbers_as_people_write_them():
    pairs = ["a.b=1e-3", "c=[1, 2e-3]", "d=newmark", "e=null", "f={g: 2}", "h=a=b", "i="]
    assert parse_overrides(pairs) == {
        "a.b": 1e-3,
        "c": [1, 2e-3],
        "d": "newmark",
        "e": None,
        "f": {"g": 2},
        "h": "a=b",
        "i": None,
    }
    with pytest.raises(NeedleSimError, match="KEY=VALUE"):
        parse_overrides(["no equals sign"])


def test_summary_rows_leave_out_what_is_not_known_and_keep_three_digits():
    summary = Summary(
        ticks=5400,
        duration=54.0,
        peak_base_force={"free": 0.0, "insertion": 1.23456},
        puncture_force=None,
        puncture_depth=None,
        max_insertion_depth=0.0599,
        max_tip_deflection=1.2e-9,
        max_marker_displacement=None,
        real_time_factor=1234.5,
    )
    rows = {name: value.strip() for name, value in summary_rows(summary)}
    assert rows == {
        "ticks": "5400",
        "peak base force, insertion": "1.23 N",
        "greatest insertion depth": "59.9 mm",
        "greatest tip deflection": "1.20e-06 mm",
        "simulated time": "54.0 s",
        "real-time factor": "1234",
    }
