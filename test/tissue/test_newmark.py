# SPDX-License-Identifier: Apache-2.0
"""Newmark's method (Eqs. 1 to 4): equilibrium, order, energy, period and decay."""

import itertools
import math

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import eigsh, spsolve

from needle_sim_ros.tissue.compliance import Footprint
from needle_sim_ros.tissue.dynamics import WithinStep
from needle_sim_ros.tissue.newmark import Motion, NewmarkRule, effective_matrix
from needle_sim_ros.tissue.yielding import Yielded

NOTHING = np.zeros((2, 2))
PUSH = np.array([[0.0, -0.1], [0.02, -0.05]])  # per row: x, z


def lowest_mode(model):
    values, shapes = eigsh(
        model.stiffness, k=1, M=model.mass, sigma=0.0, v0=np.ones(len(model.free))
    )
    return math.sqrt(values[0]), shapes[:, 0]


def damping_of(model, rule):
    return rule.alpha * model.mass + rule.beta * model.stiffness


@pytest.mark.parametrize(("delta", "xi"), [(0.5, 0.25), (0.6, 0.3025), (0.8, 0.5)])
def test_the_step_satisfies_equations_1_to_3(loaded, delta, xi):
    """After any step M a + C v + K u = Q, and v and u follow from the old ones by (2), (3)."""
    tissue = loaded(
        {
            "solver.newmark": {"delta": delta, "xi": xi},
            "tissue.damping": {"alpha": 0.7, "beta": 3e-3},
        }
    )
    model, rule, dt = tissue.model, tissue.dynamics.rule, 2e-3
    rng = np.random.default_rng(0)
    forces = [rng.normal(size=(2, 2)) for _ in range(5)]
    old = tissue.dynamics.initial()
    for force, new in zip(forces, tissue.steps(forces), strict=True):
        load = tissue.table.spread(force).ravel()[model.free]
        left = model.mass @ new.a + damping_of(model, rule) @ new.v + model.stiffness @ new.u
        scale = np.abs(model.mass @ new.a).max() + np.abs(load).max()
        np.testing.assert_allclose(left, load, atol=1e-9 * scale)
        v = old.v + dt * ((1 - delta) * old.a + delta * new.a)
        u = old.u + dt * old.v + dt**2 * ((0.5 - xi) * old.a + xi * new.a)
        np.testing.assert_allclose(new.v, v, atol=1e-11 * np.abs(v).max())
        np.testing.assert_allclose(new.u, u, atol=1e-11 * np.abs(u).max())
        old = new


def test_effective_matrix(loaded):
    """K + M / (xi dt^2) + delta C / (xi dt); Eq. (4) as printed lacks the delta."""
    model = loaded().model
    rule = NewmarkRule(step=0.01, delta=0.5, xi=0.25, alpha=2.0, beta=5e-3)
    expected = (
        model.stiffness + 4e4 * model.mass + 200 * (2.0 * model.mass + 5e-3 * model.stiffness)
    )
    difference = effective_matrix(model, rule) - expected
    assert abs(difference).max() < 1e-12 * abs(expected).max()


def test_period_of_one_mode(loaded):
    """Free vibration stays u0 cos(n phi) with tan(phi / 2) = omega dt / 2: the closed form of
    the average acceleration's period error, 2.8 % here at 11 steps a period."""
    tissue = loaded({"solver.time_step": 5e-3})
    omega, shape = lowest_mode(tissue.model)
    start = Motion(shape, 0 * shape, -(omega**2) * shape)
    phase = 2 * math.atan(omega * 5e-3 / 2)
    assert 0.02 < 1 - phase / (omega * 5e-3) < 0.05  # large enough to be seen
    states = tissue.steps(itertools.repeat(NOTHING, 200), start)
    for n, state in enumerate(states, 1):
        np.testing.assert_allclose(
            state.u, math.cos(n * phase) * shape, atol=1e-9 * np.abs(shape).max()
        )


def test_period_error_is_of_second_order(loaded):
    """(omega dt)^2 / 12 to leading order: a quarter for half the step."""
    errors = []
    for dt, count in ((2e-3, 400), (1e-3, 800)):
        tissue = loaded({"solver.time_step": dt})
        omega, shape = lowest_mode(tissue.model)
        start = Motion(shape, 0 * shape, -(omega**2) * shape)
        weighed = tissue.model.mass @ shape
        states = tissue.steps(itertools.repeat(NOTHING, count), start)
        seen = np.array([1.0] + [weighed @ state.u for state in states])
        before = np.flatnonzero((seen[:-1] > 0) & (seen[1:] <= 0))
        # the instants of the falling zeros, by the arc cosine of the neighbours
        zeros = before + np.arcsin(seen[before]) / (
            np.arcsin(seen[before]) - np.arcsin(seen[before + 1])
        )
        period = (zeros[-1] - zeros[0]) / (len(zeros) - 1) * dt
        errors.append(period * omega / (2 * math.pi) - 1)
    assert errors[0] == pytest.approx((omega * 2e-3) ** 2 / 12, rel=0.02)
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.02)


def test_energy_is_conserved_without_damping(loaded):
    """Kinetic and elastic energy after a kick of all modes, over 3000 steps."""
    tissue = loaded()
    (kicked,) = tissue.steps([PUSH])
    energy = [tissue.dynamics.energy(kicked)]
    # the first step leaves the acceleration that the load gave; let go of it consistently
    rate = kicked.v
    load = -(tissue.model.stiffness @ kicked.u)
    start = Motion(kicked.u, rate, spsolve(csc_matrix(tissue.model.mass), load))
    for state in tissue.steps(itertools.repeat(NOTHING, 3000), start):
        energy.append(tissue.dynamics.energy(state))
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


@pytest.mark.parametrize("damping", [{"alpha": 3.0, "beta": 0.0}, {"alpha": 0.0, "beta": 1e-3}])
def test_a_mode_decays_as_its_damping_says(loaded, damping):
    """exp(-zeta omega t) with 2 zeta omega = alpha + beta omega^2, from peak to peak."""
    tissue = loaded({"tissue.damping": damping, "solver.time_step": 1e-3})
    omega, shape = lowest_mode(tissue.model)
    start = Motion(shape, 0 * shape, -(omega**2) * shape)
    mass = tissue.model.mass
    states = list(tissue.steps(itertools.repeat(NOTHING, 1200), start))
    energies = np.array([tissue.dynamics.energy(state) for state in states])
    assert abs(shape @ (mass @ states[0].u)) <= 1.0
    rate = damping["alpha"] + damping["beta"] * omega**2
    whole = round(2 * math.pi / omega / 1e-3)  # a period: the energy's ripple repeats
    cycles = len(energies) // whole - 1
    fall = math.log(energies[cycles * whole] / energies[0]) / (cycles * whole * 1e-3)
    assert fall == pytest.approx(-rate, rel=0.02)
    assert (np.diff(energies) <= 1e-12 * energies[0]).all()


def test_numerical_damping_on_request(loaded):
    """delta > 1/2 takes energy out, delta = 1/2 none."""
    tissue = loaded({"solver.newmark": {"delta": 0.6, "xi": 0.3025}, "solver.time_step": 0.02})
    omega, shape = lowest_mode(tissue.model)
    start = Motion(shape, 0 * shape, -(omega**2) * shape)
    last = list(tissue.steps(itertools.repeat(NOTHING, 100), start))[-1]
    assert tissue.dynamics.energy(last) < 0.2 * tissue.dynamics.energy(start)


def smooth_push(dt, duration=0.2):
    times = dt * np.arange(1, round(duration / dt) + 1)
    return [math.sin(math.pi * t / duration) ** 8 * PUSH for t in times]


@pytest.mark.parametrize("beta", [0.0, 5e-3])
def test_second_order_in_time(loaded, beta):
    """A smooth push: halving the step quarters the error (three steps, no exact solution)."""
    seen = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        tissue = loaded({"solver.time_step": dt, "tissue.damping": {"alpha": 0.0, "beta": beta}})
        forces, every = smooth_push(dt), round(0.02 / dt)
        states = list(tissue.steps(forces))[every - 1 :: every]
        seen.append(
            [tissue.table.sample(tissue.dynamics.everywhere(s, None, None)) for s in states]
        )
    coarse, middle, fine = np.array(seen)
    ratio = np.abs(coarse - middle).max() / np.abs(middle - fine).max()
    assert math.log2(ratio) == pytest.approx(2.0, abs=0.1)


def test_a_steady_load_ends_in_equilibrium(loaded):
    """With damping the motion under a constant load ends at the quasi-static answer."""
    damped = {"tissue.damping": {"alpha": 5.0, "beta": 0.02}, "solver.time_step": 0.02}
    tissue, still = loaded(damped), loaded({"solver.dynamics": "quasi_static"})
    last = list(tissue.steps(itertools.repeat(PUSH, 400)))[-1]
    np.testing.assert_allclose(
        tissue.rows(last, PUSH), still.rows(None, PUSH), rtol=1e-6, atol=1e-12
    )


@pytest.mark.parametrize(
    "kind",
    [
        {"solver.dynamics": "quasi_static"},
        {},
        {"solver.modes": 12},
    ],
)
def test_all_ways_to_read_the_tissue_agree(loaded, kind):
    """The rows' prediction plus response, nodes, markers and the full field."""
    tissue = loaded({"tissue.damping": {"alpha": 0.0, "beta": 4e-3}, **kind})
    dynamics, model = tissue.dynamics, tissue.model
    *_, before = tissue.steps([PUSH, 2 * PUSH, -PUSH])
    prediction = dynamics.predict(before)
    after = dynamics.complete(before, prediction, tissue.table, PUSH)
    between = tissue.table.between()
    rows = prediction.rows(tissue.table) + (between @ PUSH.ravel()).reshape(2, 2)
    everywhere = dynamics.everywhere(after, tissue.table, PUSH)
    scale = np.abs(everywhere).max()
    np.testing.assert_allclose(tissue.table.sample(everywhere), rows, atol=1e-10 * scale)
    nodes = np.arange(0, model.nodes, 7)
    place = Footprint(nodes, np.cos(nodes))
    reading = tissue.table.reading(place)
    ends = WithinStep(before, prediction)
    found = dynamics.at(ends, tissue.table, PUSH, reading)
    np.testing.assert_allclose(found, place.weights @ everywhere[nodes], atol=1e-9 * scale)
    begun = place.weights @ dynamics.everywhere(before, tissue.table, -PUSH)[nodes]
    starts = ends._replace(yielded=Yielded(0.0, 1.0, np.zeros_like(PUSH), -PUSH))
    found = dynamics.at(starts, tissue.table, -PUSH, reading)
    np.testing.assert_allclose(found, begun, atol=1e-9 * scale)
    read = dynamics.at_readers(after, tissue.table, PUSH).reshape(-1, 2)
    places = np.array([[0.01, -0.01], [-0.03, -0.05]])
    shown = model.sampling(places) @ everywhere.ravel()[model.free]
    np.testing.assert_allclose(read.ravel(), shown, atol=1e-10 * scale)


def test_settling_halves_share_the_matrix_of_the_step():
    """K + M / (dt/2)^2 + C / (dt/2), term by term, is Eq. (4)'s with delta = 0.5, xi = 0.25."""
    rule = NewmarkRule(0.01, 0.5, 0.25, 0.3, 5e-3)
    assert rule.settles
    half = 0.5 * rule.step
    assert rule.mass_factor == pytest.approx(1 / half**2 + rule.alpha / half, rel=1e-14)
    assert rule.stiffness_factor == pytest.approx(1 + rule.beta / half, rel=1e-14)
    assert not NewmarkRule(0.01, 0.6, 0.3025, 0.3, 5e-3).settles


def test_a_settling_half_is_a_backward_euler_step():
    """(u, v) of M u'' + C u' + K u = 0 with one unknown, solved as one 2 x 2 system."""
    mass, stiffness, u, v = 2.0, 3.0e3, 0.7, -4.0
    rule = NewmarkRule(0.01, 0.5, 0.25, 0.3, 5e-3).settling()
    inertia, damping = rule.history(np.array([u]), np.array([v]), np.array([99.0]))
    c = rule.alpha * mass + rule.beta * stiffness
    load = mass * (inertia + rule.alpha * damping) + rule.beta * stiffness * damping
    new = load / (rule.stiffness_factor * stiffness + rule.mass_factor * mass)
    rate, acceleration = rule.rates(new, np.array([u]), np.array([v]), np.array([99.0]))
    half = 0.5 * rule.step
    expected = np.linalg.solve([[1.0, -half], [half * stiffness, mass + half * c]], [u, mass * v])
    np.testing.assert_allclose([new[0], rate[0]], expected, rtol=1e-12)
    np.testing.assert_allclose(acceleration, (expected[1] - v) / half, rtol=1e-12)
