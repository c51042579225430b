# SPDX-License-Identifier: Apache-2.0
"""Parameters while the needle goes in."""

import os
import signal
import time

import numpy as np
import pytest

from needle_sim_ros import NeedleSimError, Simulator
from needle_sim_ros.identify.online import Estimator
from needle_sim_ros.identify.online_process import EstimatorProcess
from needle_sim_ros.session.motion import Motion

TICK = 0.1
DOWN = Motion("velocity", (0.0, 0.0, -3e-3), (0.0, 0.0, 0.0))
MARKERS = {"markers": [[-0.003, 0.0, -0.005], [-0.01, 0.0, -0.02]]}
TRUTH = {
    "tissue.youngs_modulus": 20e3,
    "interaction.friction": {"static": 20.5, "kinetic": 18.0},
    "interaction.cutting.force": 0.4,
    "interaction.puncture.force": 0.65,
}
KNOWN = {
    "youngs_modulus": 20e3,
    "friction.kinetic": 18.0,
    "cutting.force": 0.4,
    "puncture.force": 0.65,
}


@pytest.fixture(scope="module")
def insertion(coarse_scene):
    """Noisy measurements of 20 mm of insertion: time, force, displacements."""
    sim, random, seen = Simulator(coarse_scene({**MARKERS, **TRUTH})), np.random.default_rng(3), []
    while not seen or sim.observe().insertion_depth < 0.02:
        shown = sim.step(DOWN.command(), TICK)
        force = shown.base_force + 0.02 * random.standard_normal(3)
        moved = shown.marker_displacements + 1e-4 * random.standard_normal((2, 3))
        seen.append((shown.time, force, moved if sim.ticks % 2 == 0 else None))
    return seen


def follow(estimator, insertion):
    for entry in insertion:
        estimator.measure(*entry)
        estimator.tick(DOWN)


def test_estimates_are_within_a_tenth_after_20_mm(coarse_scene, insertion):
    estimator = Estimator(coarse_scene(MARKERS), TICK)
    first = estimator.estimate()
    assert first.samples == 0 and first.values["youngs_modulus"] == 15e3
    for k in range(0, len(insertion), 20):
        follow(estimator, insertion[k : k + 20])
        estimator.estimate()
    found = estimator.estimate()
    for name, truth in KNOWN.items():
        assert found.values[name] == pytest.approx(truth, rel=0.1)
        assert 0 < found.standard_errors[name] < 0.1 * truth
    assert found.time == pytest.approx(insertion[-1][0])
    assert found.samples > 2 * len(insertion)


def test_uncertainty_falls_with_what_is_measured(coarse_scene, insertion):
    estimator = Estimator(coarse_scene(MARKERS), TICK, ("youngs_modulus", "cutting.force"))
    errors = [estimator.estimate().standard_errors["youngs_modulus"]]
    for k in range(0, len(insertion), 60):
        follow(estimator, insertion[k : k + 60])
        errors.append(estimator.estimate().standard_errors["youngs_modulus"])
    assert errors[0] == pytest.approx(15e3) and errors[-1] < 0.05 * errors[0]


def test_reset_begins_an_insertion_anew(coarse_scene, insertion):
    estimator = Estimator(coarse_scene(MARKERS), TICK)
    follow(estimator, insertion[:40])
    estimator.reset()
    assert estimator.estimate().samples == 0
    follow(estimator, insertion[:40])
    assert estimator.estimate().time == pytest.approx(insertion[39][0])


def test_what_cannot_be_estimated_is_refused(coarse_scene):
    with pytest.raises(NeedleSimError, match=r"cutting\.force: must be above zero"):
        Estimator(coarse_scene({"interaction.cutting.force": 0.0}), TICK, ("cutting.force",))


def test_the_process_gives_the_same_and_never_blocks(coarse_scene, insertion):
    insertion = insertion[:60]
    process = EstimatorProcess(coarse_scene(MARKERS), TICK)
    try:
        # Stopped, it takes nothing: who waited for it would wait for ever.
        os.kill(process._process.pid, signal.SIGSTOP)
        try:
            for entry in insertion:
                process.measure(*entry)
                process.tick(DOWN)
            for _ in range(21):  # beyond the data, and enough to fill the last batch
                process.tick(DOWN)
            assert process.latest() is None and process.problem == ""
        finally:
            os.kill(process._process.pid, signal.SIGCONT)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            found = process.latest()
            assert process.problem == ""
            if found is not None and found.time >= insertion[-1][0] - 1e-9:
                break
            time.sleep(0.02)
        assert found is not None
        assert found.values["youngs_modulus"] == pytest.approx(20e3, rel=0.1)
    finally:
        process.close()
    assert not process._process.is_alive()
