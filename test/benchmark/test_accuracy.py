# SPDX-License-Identifier: Apache-2.0
"""The accuracy benchmark on a coarse scene and a short protocol."""

import pytest

from needle_sim_ros import Scene
from needle_sim_ros.benchmark.accuracy import accuracy, even_out
from needle_sim_ros.benchmark.recommend import recommend
from needle_sim_ros.benchmark.variants import variants
from needle_sim_ros.view.files import save_figure
from needle_sim_ros.view.pareto import front, pareto_figure

SMALL = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 8e-3,
    "solver.track_spacing": 4e-3,
    "solver.modes": 20,
    "protocol": [
        {"duration": 1.8, "velocity": [0.0, 0.0, -0.02]},
        {"duration": 0.2},
        {"duration": 0.4, "velocity": [0.0, 0.0, 0.02]},
    ],
}


@pytest.fixture(scope="module")
def measured():
    seen = []
    scene = Scene.load("gao2016", SMALL)
    result = accuracy(scene, quick=True, progress=lambda *where: seen.append(where))
    return scene, result, seen


def test_figures(measured):
    figures = measured[1].figures
    for method in ("quasi_static", "newmark", "reduced"):
        assert 0 < figures[f"default.{method}.max_error"] < 0.3
    assert figures["paper.max_error"] > 3 * figures["default.reduced.max_error"]


def test_progress_ends_at_its_total(measured):
    seen = measured[2]
    assert seen[-1][0] == seen[-1][1] == len(seen)


def test_rows_hold_the_settings_that_made_them(measured):
    result = measured[1]
    assert {row["method"] for row in result.table} == {"quasi_static", "newmark", "reduced"}
    for row in result.table:
        assert row["max_error"] == max(
            row[name] for name in ("tip_deflection", "base_force", "friction_force", "markers")
        )
        assert row["tick_ms"] > 0
        pairs = dict(pair.split("=") for pair in row["settings"].split())
        assert pairs["solver.dynamics"] in ("newmark", "quasi_static")
    coarse = next(row for row in result.table if row["run"] == "track x 2")
    assert coarse["settings"].endswith("solver.track_spacing=0.008")
    assert coarse["unknowns"] < result.table[0]["unknowns"]


def test_ticks_are_in_proportion_to_the_papers_iteration(measured):
    """As long as in its own run, for a machine that is equally busy in all of them."""
    paced = [row["tick_ms"] * row["paper_over_it"] for row in measured[1].table]
    assert paced == pytest.approx([paced[0]] * len(paced))
    rows = [
        {"tick_ms": 2.0, "paper_over_it": 5.0},  # the paper's iteration took 10
        {"tick_ms": 4.0, "paper_over_it": 5.0},  # 20: everything took twice as long
        {"tick_ms": 1.0, "paper_over_it": 10.0},
    ]
    even_out(rows)
    assert [row["tick_ms"] for row in rows] == [2.0, 2.0, 1.0]
    assert [row["measured_tick_ms"] for row in rows] == [2.0, 4.0, 1.0]


def test_recommendation(measured):
    table = measured[1].table
    fastest = recommend(table, error=1.0)
    assert fastest["tick_ms"] == min(
        r["tick_ms"] for r in table if r["compared"] and r["run"] != "paper" and r["max_error"] <= 1
    )
    best = recommend(table, budget=1e6)
    assert all(best["max_error"] <= r["max_error"] for r in table if r["compared"])
    assert recommend(table, budget=1e-9) is None


def test_picture(measured, tmp_path):
    rows = [row for row in measured[1].table if row["compared"]]
    figure = pareto_figure(rows, "title")
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert sum("default" in label for label in labels) == 3
    assert sum("paper" in label for label in labels) == 2
    save_figure(figure, tmp_path / "pareto.png")
    assert (tmp_path / "pareto.png").stat().st_size > 10_000


def test_front_keeps_what_nothing_beats():
    pairs = [(1, 5), (2, 3), (2, 4), (3, 3), (4, 1)]
    rows = [{"tick_ms": t, "max_error": e} for t, e in pairs]
    assert [(r["tick_ms"], r["max_error"]) for r in front(rows)] == [(1, 5), (2, 3), (4, 1)]


def test_variants_are_admissible_scenes():
    for name, quick in (("gao2016", True), ("gao2016", False), ("gao2016_steel", False)):
        scene = Scene.load(name)
        runs = variants(scene, quick)
        assert len({(run.method, run.name) for run in runs}) == len(runs) > 10
        for run in runs:
            scene.with_changes(run.changes)
