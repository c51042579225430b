# SPDX-License-Identifier: Apache-2.0
"""Fits whose truth is known, and what is said about what the data do not tell."""

import numpy as np
import pytest

from needle_sim_ros.errors import NeedleSimError, SessionError
from needle_sim_ros.identify.fit import Fitter, correlation_time, uncertainty
from needle_sim_ros.identify.parameters import chosen
from needle_sim_ros.identify.prediction import predict
from needle_sim_ros.identify.residuals import Residuals, Trial, read_noise
from needle_sim_ros.parallel import SerialExecutor
from needle_sim_ros.session.experiment import Experiment, Measured
from needle_sim_ros.session.motion import Motion

TICK = 0.25
NAMES = ["youngs_modulus", "friction.kinetic", "cutting.force"]
TRUTH = {"youngs_modulus": 18e3, "friction.kinetic": 11.0, "cutting.force": 0.36}
NOISE = {"force": 0.02, "markers": 1e-4}


@pytest.fixture(scope="module")
def scene(coarse_scene):
    return coarse_scene({"markers": [[-0.003, 0.0, -0.01], [-0.01, 0.0, -0.02]]})


@pytest.fixture(scope="module")
def experiment(scene):
    """30 mm in, a hold, and out; noisy."""
    speeds = [-4e-3] * 44 + [0.0] * 6 + [4e-3] * 44
    motions = [Motion("velocity", (0.0, 0.0, v), (0.0, 0.0, 0.0)) for v in speeds]
    time, random = TICK * np.arange(1, len(motions) + 1), np.random.default_rng(4)
    nothing = {name: Measured(time, np.zeros((len(time), 3))) for name in NOISE}
    exact = predict(scene, Experiment("noisy", TICK, motions, nothing), TRUTH)
    measured = {
        name: Measured(time, rows + NOISE[name] * random.standard_normal(rows.shape))
        for name, rows in exact.items()
    }
    return Experiment("noisy", TICK, motions, measured)


def fitter(scene, experiment, names):
    start = {"youngs_modulus": 15e3, "friction.kinetic": 14.0, "cutting.force": 0.3}
    start |= {"base_offset.x": 0.0, "puncture.force": 0.5}
    residuals = Residuals([Trial(experiment, scene)], NOISE, SerialExecutor())
    return Fitter(residuals, chosen(names), np.array([start[name] for name in names]))


def test_parameters_are_found_within_their_intervals(scene, experiment):
    fit = fitter(scene, experiment, NAMES).fit()
    for k, name in enumerate(NAMES):
        assert abs(fit.values[k] - TRUTH[name]) < 3.5 * fit.standard_errors[k]
        assert fit.standard_errors[k] < 0.05 * TRUTH[name]
        low, high = fit.intervals[k]
        assert low < fit.values[k] < high
        assert high - low == pytest.approx(4 * fit.standard_errors[k], rel=0.05)
    assert 0.8 < fit.reduced_chi_square < 1.2 and fit.inflation == 1.0
    assert fit.after[0]["force"] == pytest.approx(0.02, rel=0.2)
    assert fit.before[0]["force"] > 1.5 * fit.after[0]["force"]
    np.testing.assert_allclose(np.diag(fit.correlations), 1.0)
    assert fit.correlations[1, 2] < -0.3  # more friction looks like less cutting
    assert fit.undetermined == []


def test_what_the_data_do_not_tell_is_named():
    force = np.linspace(0, 1, 50)
    jacobian = np.column_stack([force, force * (1 + 1e-4), np.ones(50), np.zeros(50)])
    covariance, found = uncertainty(jacobian, 1.0, ["a", "b", "c", "d"])
    assert np.isinf(covariance[3, 3]) and np.isfinite(covariance[2, 2])
    texts = [combination.text() for combination in found]
    assert any("no effect" in text and "d" in text for text in texts)
    together = next(c for c in found if set(c.shares) == {"a", "b"})
    assert together.shares["a"] * together.shares["b"] == pytest.approx(-1, abs=0.01)
    assert together.standard_error > 100


def test_misfit_that_lasts_counts_as_few_measurements():
    noise = np.random.default_rng(2).standard_normal((4000, 1))
    assert correlation_time([{"force": noise}]) == pytest.approx(1.0, abs=0.3)
    slow = np.repeat(noise[::20], 20, axis=0)
    assert correlation_time([{"force": slow}]) == pytest.approx(20, rel=0.3)


def test_a_needle_that_never_reaches_the_tissue_is_refused(scene, experiment):
    away = [Motion("velocity", (0.0, 0.0, 1e-3), (0.0, 0.0, 0.0))] * 5
    above = Experiment("above", TICK, away, experiment.measured)
    with pytest.raises(SessionError, match=r"above: .* never reaches"):
        predict(scene, above, {})


def test_nothing_to_fit_to_is_refused(scene, experiment):
    with pytest.raises(SessionError, match="none of torque"):
        Residuals([Trial(experiment, scene)], {"torque": 1.0}, SerialExecutor())
    with pytest.raises(NeedleSimError, match="force"):
        read_noise("force=0")
    with pytest.raises(NeedleSimError, match="at the start: must be above zero"):
        Fitter(
            Residuals([Trial(experiment, scene)], NOISE, SerialExecutor()),
            chosen(["cutting.force"]),
            np.zeros(1),
        )


def test_no_trial_of_a_fit_has_puncture_below_cutting(scene, experiment):
    """The search begins on that border, and leaves it."""
    tried = []

    class Watched(Residuals):
        def predictions(self, points):
            tried.extend(points)
            return super().predictions(points)

    names = ["cutting.force", "puncture.force"]
    residuals = Watched([Trial(experiment, scene)], NOISE, SerialExecutor())
    found = Fitter(residuals, chosen(names), np.array([0.45, 0.45])).fit().named()
    assert len(tried) > 5
    assert all(p["puncture.force"] >= p["cutting.force"] * (1 - 1e-12) for p in tried)
    assert found["puncture.force"] == pytest.approx(0.5, rel=0.1)
    with pytest.raises(NeedleSimError, match=r"puncture.force = 0.4 .* must be >= cutting.force"):
        Fitter(residuals, chosen(names), np.array([0.6, 0.4]))


def test_a_side_that_the_model_refuses_is_left_out(scene, experiment):
    """A region's own static friction bounds the kinetic: the derivative is taken from below."""
    region = {"name": "layer", "shape": "half_space", "center": [0, 0, -0.02]}
    bounded = scene.with_changes(
        {
            "tissue.regions": [{**region, "friction_static": 14.0}],
            "interaction.friction.kinetic": 13.999,
        }
    )
    residuals = Residuals([Trial(experiment, bounded)], NOISE, SerialExecutor())
    fitter = Fitter(residuals, chosen(["friction.kinetic"]), np.array([13.999]))
    slope = fitter.jacobian(np.ones(1))
    assert np.isfinite(slope).all() and np.abs(slope).max() > 0
