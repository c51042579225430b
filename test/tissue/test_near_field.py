# SPDX-License-Identifier: Apache-2.0
"""Kelvin's solution in place of cells as fine as the needle: closed forms, and a finer mesh."""

import math

import numpy as np
import pytest

from needle_sim_ros import Scene, Simulator
from needle_sim_ros.benchmark.equilibrium import residuals
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.near_field import NearField, _distances, disc_radius

RADIUS, SPACING = 1e-3, 2e-3
DOWN = np.array([0.0, 0.0, -1.0])
POINTS = np.array([[0.0004, 0.0003, -0.002 * k] for k in range(9)])


def scene(across, along, changes=None):
    return Scene.from_dict(
        {
            "name": "block",
            "dimension": 3,
            "tissue": {
                "size": [0.024, 0.024, 0.024],
                "youngs_modulus": 15e3,
                "poisson_ratio": 0.45,
                "mesh": {
                    "spacing_across": across,
                    "spacing_along": along,
                    "growth": 2.0,
                    "band": 3e-3,
                },
            },
            "needle": {"length": 0.04, "radius": RADIUS, "youngs_modulus": 2e11},
            "interaction": {"friction": {"static": 2.0, "kinetic": 2.0}, "cutting": {"force": 0.1}},
            "solver": {"track_spacing": SPACING},
            "base": {"position": [0, 0, 0.041]},
            "protocol": [{"duration": 3.0, "velocity": [0, 0, -6e-3]}],
        },
        changes,
    )


def by_mesh(made, radius):
    """Displacement of the hat in the middle per force on it, aside and along, m/N."""
    model = TissueModel(made)
    hat = Coupling(model, radius).hat(*POINTS[3:6])
    loads = np.zeros((model.nodes, 3, 2))
    loads[hat.nodes, 0, 0] = loads[hat.nodes, 2, 1] = hat.weights
    right = loads.reshape(-1, 2)[model.free]
    factor = Factor(model.stiffness, model.elimination_order)
    return np.diag(right.T @ factor.solve(np.asfortranarray(right)))


def test_mean_distance_in_a_disc():
    """Of two places in a disc the mean inverse distance is 16 / (3 pi a)."""
    inverse, across, along = _distances(np.zeros(1), RADIUS)[:, 0]
    assert inverse == pytest.approx(16 / (3 * math.pi * RADIUS), rel=1e-6)
    assert across == pytest.approx(inverse / 2, rel=1e-9)
    assert along == 0


def test_a_coarse_mesh_does_as_a_fine_one():
    """Cells of 3 mm with a track of 2 mm against cells of 0.6 of a radius, within 8 %; alone the
    coarse ones are a fifth too stiff at least. (The rest is the block's, 24 mm wide.)"""
    fine, coarse = scene(0.6e-3, 1.5e-3, {"tissue.mesh.band": 2e-3}), scene(3e-3, 3e-3)
    true = by_mesh(fine, RADIUS)
    near = NearField(coarse)
    added = near.row(POINTS[:4], POINTS[4], DOWN)[-3:]
    found = by_mesh(coarse, near.wide) + np.diag(added)[[0, 2]]
    np.testing.assert_allclose(found, true, rtol=0.08)
    assert (by_mesh(coarse, RADIUS) < 0.8 * true).all()


def test_it_falls_with_the_cube_of_the_distance():
    near = NearField(scene(3e-3, 3e-3))
    rows = near.row(POINTS, POINTS[-1] + SPACING * DOWN, DOWN).reshape(-1, 3, 3)
    along = rows[:, 2, 2]
    assert (np.diff(along) > 0).all()  # the nearer the more
    # 8 and 4 spacings away, 5 and 2.7 wide radii
    assert along[1] / along[5] == pytest.approx((4 / 8) ** 3, rel=0.3)


def test_a_force_between_the_ends_turns_nothing():
    near = NearField(scene(3e-3, 3e-3))
    forces = np.zeros_like(POINTS)
    forces[4] = 0.1, -0.2, 0.3
    start = POINTS[4] - 2e-3 * DOWN
    turned = near.turning(POINTS, start, DOWN, 4e-3).by(forces)
    ahead = near.turning(POINTS, POINTS[4], DOWN, 4e-3).by(forces)
    assert np.abs(turned).max() < 1e-9 * np.abs(ahead).max()
    # the tissue at the force goes with it, that ahead less
    assert (ahead * forces[4] < 0).all()


def test_a_point_laid_since_bears_nothing_yet():
    """Forces on fewer points than it was worked out for, and on more."""
    near = NearField(scene(3e-3, 3e-3))
    turning = near.turning(POINTS, POINTS[-1], DOWN, 4e-3)
    forces = np.random.default_rng(3).normal(size=POINTS.shape)
    fewer, zero = forces[:-1], np.zeros((1, 3))
    np.testing.assert_allclose(
        turning.by(fewer), turning.by(np.vstack([fewer, zero])), rtol=1e-13, atol=0
    )
    np.testing.assert_array_equal(turning.by(forces), turning.by(np.vstack([forces, zero + 1.0])))


def test_nothing_is_added_where_the_mesh_shows_it():
    assert disc_radius(scene(RADIUS, 2e-3)) == RADIUS
    assert disc_radius(Scene.load("gao2016")) == Scene.load("gao2016").needle.radius
    assert disc_radius(scene(3e-3, 3e-3)) == 3e-3


@pytest.mark.parametrize(
    "dynamics",
    [
        {},
        {"solver.dynamics": "newmark", "solver.time_step": 0.1, "solver.modes": 6},
        {"solver.dynamics": "newmark", "solver.time_step": 0.1},
    ],
    ids=["quasi-static", "reduced", "full"],
)
def test_equilibrium_holds(dynamics):
    """The whole tissue's displacement and what is added are what the contact works with."""
    changes = {"needle.tip.deviation_angle": 0.1, **dynamics}
    if dynamics:
        changes["tissue.damping"] = {"beta": 0.01}
    simulator = Simulator(scene(3e-3, 3e-3, changes))
    for _ in range(28):
        simulator.step(BaseCommand(velocity=[0, 0, -6e-3]), 0.1)
    assert simulator.observe().insertion_depth > 0.01
    worst, name = residuals(simulator).worst()
    assert worst < 1e-6, name


def test_markers_feel_the_narrow_needle():
    """A force on a disc moves a place beside it as the mean of Kelvin's solution over the disc:
    here against one worked out place by place."""
    near = NearField(scene(3e-3, 3e-3))
    before, point, after = POINTS[3:6]
    marker = point + np.array([6e-3, 1e-3, 2e-3])
    modulus = 15e3 / (2 * 1.45)
    rng = np.random.default_rng(0)
    side = np.sign(rng.uniform(-1, 1, 200_000))
    along = (1 - np.sqrt(rng.uniform(0, 1, len(side)))) * side * SPACING
    angle, spread = rng.uniform(0, 2 * np.pi, len(side)), np.sqrt(rng.uniform(0, 1, len(side)))
    disc = np.column_stack([np.cos(angle) * spread, np.sin(angle) * spread, 0 * spread])

    def kelvin(radius):
        offset = marker - point + along[:, None] * DOWN - radius * disc
        rho = np.linalg.norm(offset, axis=1)
        outer = np.einsum("ka,kb,k->ab", offset, offset, rho**-3) / len(rho)
        return ((3 - 4 * 0.45) * np.mean(1 / rho) * np.eye(3) + outer) / (
            16 * np.pi * modulus * (1 - 0.45)
        )

    expected = kelvin(RADIUS) - kelvin(near.wide)
    found = near.at(marker[None], before, point, after)
    np.testing.assert_allclose(found, expected, atol=0.06 * np.abs(expected).max())
