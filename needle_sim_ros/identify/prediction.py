# SPDX-License-Identifier: Apache-2.0
"""What a scene with certain parameters says at the times of an experiment's measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby

import numpy as np

from needle_sim_ros.errors import NeedleSimError, SessionError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.identify.model import ParametricModel
from needle_sim_ros.identify.parameters import Values, bias_of, offset_of
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.agreement import NAMES
from needle_sim_ros.session.experiment import Experiment, interpolated
from needle_sim_ros.session.motion import Motion

Predicted = Mapping[str, Vector]
_KEPT = 4  # prepared tissues in one process
_models: dict[Scene, ParametricModel] = {}


def model_of(scene: Scene) -> ParametricModel:
    """Return the model of a scene, prepared once in this process."""
    if scene not in _models:
        while len(_models) >= _KEPT:
            del _models[next(iter(_models))]
        _models[scene] = ParametricModel(scene)
    return _models[scene]


def only(experiment: Experiment, quantities: list[str]) -> Experiment:
    """Return an experiment with these quantities alone, small enough to send about."""
    kept = {name: experiment.measured[name] for name in quantities if name in experiment.measured}
    return replace(experiment, measured=kept, recorded=None, scene_text="")


def predict(scene: Scene, experiment: Experiment, values: Values) -> Predicted | str:
    """Return predicted rows by quantity, or why there are none: a task for any process.

    Parameters
    ----------
    scene : Scene
        Of this experiment, see :meth:`Experiment.scene`.
    experiment : Experiment
    values : mapping
        Of the parameters that differ from the scene's.
    """
    try:
        return predicted_by(model_of(scene), experiment, values)
    except SessionError:
        raise
    except NeedleSimError as error:  # a trial of the fit may go where the model ends
        return str(error)


def predicted_by(model: ParametricModel, experiment: Experiment, values: Values) -> Predicted:
    """Step a model through an experiment.

    Raises
    ------
    SessionError
        When the needle never reaches the tissue.
    """
    simulator, factor = model.at(values)
    offset = np.array(offset_of(values))
    names = {name: NAMES[name] for name in experiment.measured}
    first = simulator.observe()
    rows = {name: [getattr(first, member)] for name, member in names.items()}
    touched = False
    for motion, same in groupby(experiment.motions):
        command = _moved(motion, offset).command()
        for _ in same:
            observation = simulator.step(command, experiment.tick_period)
            for name, member in names.items():
                rows[name].append(getattr(observation, member))
        touched = touched or observation.process is not Process.FREE
    if not touched:
        raise SessionError(
            f"{experiment.name}: the scene does not fit the commands: the needle never reaches"
            " the tissue (base.position, needle.length, or the transform of the command topic)"
        )
    found = {}
    for name, values_ in rows.items():
        array = np.array(values_)
        if name in ("force", "torque"):
            array *= factor
        if name == "force":
            array += np.array(bias_of(values))
        found[name] = interpolated(experiment.measured[name].time, experiment.ends, array)
    return found


def _moved(motion: Motion, offset: Vector) -> Motion:
    if motion.kind != "pose" or motion.linear is None or not offset.any():
        return motion
    x, y, z = (np.array(motion.linear) + offset).tolist()
    return Motion("pose", (x, y, z), motion.angular)
