# SPDX-License-Identifier: Apache-2.0
"""Benchmark results: JSON that any reader takes, tables that people read."""

import json
import math

import numpy as np

from needle_sim_ros.benchmark.result import BenchmarkResult


def example():
    return BenchmarkResult(
        "speed",
        "gao2016",
        {"ratio": np.float64(31.25), "not_measured": None, "broken": math.nan},
        [
            {"section": "ticks", "run": "paper", "ticks": np.int64(7), "median_ms": 8.71234},
            {"section": "ticks", "run": "own", "ticks": 7, "growing": np.bool_(True)},
            {"section": "parts", "function": "solve", "share": math.inf},
        ],
    )


def test_json_has_figures_and_table_and_no_nan(tmp_path):
    target = tmp_path / "made" / "speed.json"
    example().write_json(target)
    content = json.loads(target.read_text(), parse_constant=lambda name: 1 / 0)
    assert content["figures"] == {"ratio": 31.25, "not_measured": None, "broken": None}
    assert content["table"][0]["ticks"] == 7
    assert content["table"][1]["growing"] is True
    assert content["table"][2]["share"] is None
    assert [path.name for path in target.parent.iterdir()] == ["speed.json"]


def test_text_aligns_each_section_by_itself():
    lines = example().text().splitlines()
    start = lines.index("ticks")
    assert lines[start + 1].split() == ["run", "ticks", "median_ms", "growing"]
    assert lines[start + 2].split() == ["paper", "7", "8.712", "-"]
    assert lines[start + 3].split() == ["own", "7", "-", "yes"]
    assert len({len(line) for line in lines[start + 1 : start + 4]}) == 1
    assert lines[lines.index("parts") + 1].split() == ["function", "share"]
    assert lines[-3].split() == ["ratio", "31.25"]
    assert lines[-2].split() == ["not_measured", "-"]


def test_a_result_without_rows_still_prints():
    assert BenchmarkResult("soak", "gao2016", {"ticks": 0.0}).text().endswith("ticks       0\n")
