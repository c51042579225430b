# SPDX-License-Identifier: Apache-2.0
"""A tissue so small that thousands of steps, or all of its modes, cost nothing."""

import numpy as np
import pytest

from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.tissue.build import build_tissue
from needle_sim_ros.tissue.response import ResponseTable

TINY = {
    "tissue.mesh.uniform": True,
    "tissue.mesh.spacing_across": 0.02,
    "tissue.mesh.spacing_along": 0.016,
    "solver.track_spacing": 0.008,
    "solver.dynamics": "newmark",
    "solver.time_step": 2e-3,
    "tissue.damping": {"alpha": 0.0, "beta": 0.0},
    "markers": [[0.01, 0.0, -0.01], [-0.03, 0.0, -0.05]],
}


class Loaded:
    """A tissue with two track points that can be loaded, and its steps.

    Attributes
    ----------
    dynamics, model
        Of the package.
    table : ResponseTable
        Rows at 5 mm and at 30 mm depth.
    """

    def __init__(self, scene):
        built = build_tissue(scene)
        self.model, self.dynamics = built.model, built.dynamics
        hat = Coupling(built.model, scene.needle.radius).hat
        self.table = ResponseTable(built.dynamics.compliance, built.dynamics.modes)
        step = np.array([0.0, -0.008])
        for place in (np.array([0.0, -0.008]), np.array([0.004, -0.03])):
            footprint = hat(place - step, place, place + step)
            self.table = self.table.appended(self.table.row(footprint))

    def steps(self, forces, state=None):
        """Yield the state after each step; `forces` has one (2, 2) array a step."""
        dynamics = self.dynamics
        state = dynamics.initial() if state is None else state
        for force in forces:
            prediction = dynamics.predict(state)
            state = dynamics.complete(state, prediction, self.table, force)
            yield state

    def rows(self, state, force):
        """Return the displacement of the rows from the full field, (2, 2)."""
        return self.table.sample(self.dynamics.everywhere(state, self.table, force))


@pytest.fixture(scope="session")
def loaded(coarse_scene):
    """Make a tiny tissue with changes to the scene."""

    def make(changes=None):
        return Loaded(coarse_scene({**TINY, **(changes or {})}))

    return make
