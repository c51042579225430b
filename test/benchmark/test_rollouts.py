# SPDX-License-Identifier: Apache-2.0
"""Benchmarks of planning on a coarse scene: what they report, not how fast it is."""

import json

import pytest

from needle_sim_ros.benchmark import plan as plan_benchmark
from needle_sim_ros.benchmark import rollouts as rollouts_benchmark
from needle_sim_ros.benchmark.plan import plan
from needle_sim_ros.benchmark.rollouts import rollouts
from needle_sim_ros.errors import NeedleSimError


@pytest.fixture
def scene(coarse_scene):
    return coarse_scene({"protocol": [{"duration": 3.0, "velocity": [0.0, 0.0, -0.012]}]})


def test_rollouts(scene, monkeypatch):
    monkeypatch.setattr(rollouts_benchmark, "_QUICK_ROUNDS", 1)
    monkeypatch.setattr(rollouts_benchmark, "available_cores", lambda: 1)
    monkeypatch.setattr(rollouts_benchmark, "_TRIALS", 2)
    monkeypatch.setattr(rollouts_benchmark, "_TURNS", 1)
    seen = []
    result = rollouts(scene, quick=True, progress=lambda *where: seen.append(where))
    assert seen[-1][0] == seen[-1][1]
    depths = [row["depth_mm"] for row in result.table if "depth_mm" in row]
    assert depths == pytest.approx([26 / 3, 52 / 3, 26.0], rel=1e-6)
    figures = result.figures
    assert figures["end_error"] < 0.05
    assert min(v for v in figures.values() if v is not None) > 0
    assert figures["branches_per_s"] > figures["rollouts_per_s"]


def test_plan(scene, monkeypatch, tmp_path):
    """Targets stream to a file; what stands there is not planned for again."""
    monkeypatch.setattr(plan_benchmark, "_QUICK_VERIFIED", 0)
    path = tmp_path / "targets.jsonl"
    first = plan(scene, quick=True, targets=1, results=path)
    before = path.read_text()
    result = plan(scene, quick=True, targets=2, results=path)
    assert path.read_text().startswith(before)
    assert result.table[0] == json.loads(before.splitlines()[1])
    assert first.table[0]["x_mm"] == result.table[0]["x_mm"] != result.table[1]["x_mm"]
    assert [row["reachable"] for row in result.table] == [True, True]
    assert result.figures["targets"] == 2
    assert result.figures["miss_p95_m"] < 1e-4 < result.figures["plain_aim_miss_median_m"]
    assert result.figures["full_model_miss_max_m"] is None
    other = scene.with_changes({"needle.tip.deviation_angle": 0.03})
    with pytest.raises(NeedleSimError, match="another scene"):
        plan(other, quick=True, targets=2, results=path)
