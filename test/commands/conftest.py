# SPDX-License-Identifier: Apache-2.0
"""gao2016 made quick: coarse, without inertia, ten times as fast."""

import json

import pytest

from needle_sim_ros.cli import main

_COARSE = {
    "solver.dynamics": "quasi_static",
    "solver.time_step": 0.02,
    "solver.track_spacing": 4e-3,
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "interaction.cutting.relaxation_time": 0.3,
    "markers": [[0.005, 0.0, -0.01], [-0.01, 0.0, -0.04]],
    "protocol": [
        {"duration": 2.335, "velocity": [0, 0, -0.03]},
        {"duration": 2.0},
        {"duration": 2.335, "velocity": [0, 0, 0.03]},
    ],
}


@pytest.fixture(scope="session")
def coarse() -> list[str]:
    """Return the options that make gao2016 quick."""
    return [part for k, v in _COARSE.items() for part in ("--set", f"{k}={json.dumps(v)}")]


@pytest.fixture(scope="session")
def recorded(coarse, tmp_path_factory):
    """Run, record and plot once; return the folder with out.json, out.png and bag."""
    folder = tmp_path_factory.mktemp("run")
    files = ["--json", f"{folder}/out.json", "--plot", f"{folder}/out.png"]
    assert main(["run", "gao2016", *coarse, *files, "--record", f"{folder}/bag"]) == 0
    return folder
