# SPDX-License-Identifier: Apache-2.0
"""The node's loop is measured on the node itself, in real time."""

import pytest

from needle_sim_ros import Scene
from needle_sim_ros.ros.loop_measurement import measure_loop

SMALL = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "solver.track_spacing": 4e-3,
    "solver.dynamics": "quasi_static",
    "protocol": [{"duration": 1.5, "velocity": [0.0, 0.0, -0.03]}, {"duration": 0.5}],
}


@pytest.mark.parametrize("watched", [False, True])
def test_counts_the_ticks_of_the_protocol(watched):
    row = measure_loop(Scene.load("gao2016", SMALL), record=watched, subscribe=watched)
    # 2 s at 100 Hz, and up to one period of the diagnostics at each end.
    assert row["ticks"] + row["overruns"] >= 195
    assert row["ticks"] <= 500
    assert row["overruns"] >= 0
    assert 0 < row["median_ms"] <= row["p99_ms"] <= row["max_ms"]
