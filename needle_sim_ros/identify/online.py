# SPDX-License-Identifier: Apache-2.0
"""Parameters while the needle goes in: recursive Gauss-Newton over all that was measured.

The model and one copy of it beside each parameter follow the commands. Every measurement
adds to the normal equations of the parameters, by the difference of the copies; when the
estimate has left the place where the copies stand, they start anew from there and catch up,
which is cheap as the tissue is not factorised again. The result is that of a least-squares fit
to everything so far. Needs no ROS; runs in the thread or process of whoever calls it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.identify.model import ParametricModel, quasi_static
from needle_sim_ros.identify.parameters import chosen, values_in
from needle_sim_ros.identify.residuals import NOISE
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.experiment import joined
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.simulator import Simulator

ONLINE = ("youngs_modulus", "friction.kinetic", "cutting.force", "puncture.force")
_INTERVAL = 0.05  # s; ticks are joined to about this
_STEP = 0.02  # of finite differences, relative
_PRIOR = 1.0  # standard deviation of a parameter before any measurement, relative
_MOVED = 0.02  # change of the estimate, relative, from which the copies start anew
_SURE = 0.3  # ... and in standard errors
_LARGEST_MOVE = 0.5
_OPENING = 1.05  # least puncture force of a copy, in cutting forces
_ITERATIONS = 3
_PAUSE = 20  # least number of steps between fresh starts: catching up takes their time again
_BOUNDS = (0.05, 20.0)  # of the values at the start


@dataclass(frozen=True)
class Estimate:
    """What is known at a time.

    Attributes
    ----------
    time : float
        Simulated time of the last measurement taken in, s.
    values, standard_errors : mapping of str to float
        SI units.
    samples : int
        Measured numbers taken in.
    """

    time: float
    values: Mapping[str, float]
    standard_errors: Mapping[str, float]
    samples: int


@dataclass
class _Sample:
    time: float
    values: Vector  # weighted; NaN where nothing was measured


@dataclass
class _Copy:
    """One of the models that follow the commands, and what it shows, weighted."""

    simulator: Simulator
    factor: float
    shows: Vector = field(default_factory=lambda: np.zeros(0))


class Estimator:
    """Estimates parameters from commands and measurements.

    Friction keeps the ratio of static to kinetic that the scene has.

    Parameters
    ----------
    scene : Scene
        Its values are the start; simulated without inertia.
    tick_period : float
        s.
    parameters : sequence of str
        Positive ones of :data:`~needle_sim_ros.identify.parameters.PARAMETERS`.
    noise : mapping of str to float, optional
        Standard deviations of ``force`` (N) and ``markers`` (m).

    Raises
    ------
    NeedleSimError
        On parameters that cannot be estimated.
    """

    def __init__(
        self,
        scene: Scene,
        tick_period: float,
        parameters: Sequence[str] = ONLINE,
        noise: Mapping[str, float] | None = None,
    ) -> None:
        self.parameters = chosen(parameters)
        self._noise = {**NOISE, **(noise or {})}
        self._model = ParametricModel(quasi_static(scene))
        start = values_in(scene, self.parameters)
        wrong = [p.name for p in self.parameters if not (p.positive and start[p.name] > 0)]
        if wrong:
            raise NeedleSimError(f"parameters {', '.join(wrong)}: must be above zero in the scene")
        friction = scene.interaction.friction
        self._ratio = friction.static / friction.kinetic if friction.kinetic > 0 else 1.0
        self._start = np.array(list(start.values()))
        self._period, self._interval = tick_period, max(1, round(_INTERVAL / tick_period))
        self._flat = scene.dimension == 2
        self._markers = len(scene.markers)
        self._reference = np.ones(len(start))  # of the copies, in values at the start
        self.reset()

    # ---------------------------------------------------------------------- following
    def reset(self) -> None:
        """Forget commands and measurements, as at the start of an insertion; keep the values."""
        self._steps: list[tuple[Motion, float]] = []
        self._waiting: list[Motion] = []
        self._samples: list[_Sample] = []
        self._taken = 0  # samples that are in the normal equations
        self._restart_at = _PAUSE
        self._begin_again()

    def _begin_again(self) -> None:
        steps = np.vstack([np.zeros(len(self._reference)), _STEP * np.eye(len(self._reference))])
        self._copies = []
        for step in steps:
            values = self._named(self._reference * (1.0 + step) * self._start)
            simulator, factor = self._model.at(values)
            self._copies.append(_Copy(simulator, factor))
        self._show()
        self._at, self._done, self._taken, self._count = 0.0, 0, 0, 0
        prior = np.full(len(self._reference), 1.0 / _PRIOR**2)
        self._information = np.diag(prior)
        # towards the values at the start, relative to the reference
        self._pull = prior * (1.0 / self._reference - 1.0)

    def _sensitive(self, reference: Vector) -> Vector:
        """Keep the puncture force above the cutting force: below it would change nothing."""
        names = [p.name for p in self.parameters]
        if "puncture.force" in names and "cutting.force" in names:
            cutting, puncture = names.index("cutting.force"), names.index("puncture.force")
            least = _OPENING * reference[cutting] * self._start[cutting] / self._start[puncture]
            reference[puncture] = max(reference[puncture], least)
        return reference

    def _named(self, values: Vector) -> dict[str, float]:
        named = {p.name: float(v) for p, v in zip(self.parameters, values, strict=True)}
        if "friction.kinetic" in named and "friction.static" not in named:
            named["friction.static"] = self._ratio * named["friction.kinetic"]
        return named

    def _show(self) -> None:
        for copy in self._copies:
            seen = copy.simulator.observe()
            force = copy.factor * seen.base_force / self._noise["force"]
            moved = seen.marker_displacements / self._noise["markers"]
            copy.shows = self._row(force, moved)

    def _row(self, force: Vector, moved: Vector) -> Vector:
        if self._flat:
            force, moved = force[[0, 2]], moved[:, [0, 2]]
        return np.concatenate([force, moved.ravel()])

    def tick(self, motion: Motion) -> None:
        """Follow one tick of the base."""
        if self._waiting and self._waiting[-1].kind != motion.kind:
            self._join()
        self._waiting.append(motion)
        if len(self._waiting) >= self._interval:
            self._join()

    def _join(self) -> None:
        count = len(self._waiting)
        self._steps.append((joined(self._waiting, count), count * self._period))
        self._waiting = []
        self._follow()

    def measure(
        self, time: float, force: Sequence[float] | None = None, markers: Vector | None = None
    ) -> None:
        """Take a measurement in.

        Parameters
        ----------
        time : float
            Since the start, s; out of order or from before the last is left out.
        force : sequence of 3 floats, optional
            Base frame, as the simulator's ``base_force``, N; NaN where not measured.
        markers : ndarray, shape (m, 3), optional
            Displacements of the scene's markers, m; NaN where not seen.
        """
        if self._samples and time < self._samples[-1].time:
            return
        nothing = np.full(3, np.nan)
        shown = nothing if force is None else np.asarray(force, dtype=float)
        moved = np.full((self._markers, 3), np.nan)
        if markers is not None and np.shape(markers) == moved.shape:
            moved = np.asarray(markers, dtype=float)
        row = self._row(shown / self._noise["force"], moved / self._noise["markers"])
        if np.isfinite(row).any():
            self._samples.append(_Sample(time, row))

    def _follow(self) -> None:
        """Step the copies to where the commands are, and take in what was measured on the way."""
        while self._done < len(self._steps):
            motion, duration = self._steps[self._done]
            before = [copy.shows for copy in self._copies]
            command = motion.command()
            for copy in self._copies:
                copy.simulator.step(command, duration)
            self._show()
            self._take_in(before, duration)
            self._at += duration
            self._done += 1

    def _take_in(self, before: list[Vector], duration: float) -> None:
        while self._taken < len(self._samples):
            sample = self._samples[self._taken]
            part = (sample.time - self._at) / duration
            if part > 1.0 + 1e-9:
                return
            self._taken += 1
            if part < 0.0:
                continue
            rows = [
                b + part * (copy.shows - b) for b, copy in zip(before, self._copies, strict=True)
            ]
            seen = np.isfinite(sample.values)
            apart = (sample.values - rows[0])[seen]
            columns = [(row - rows[0])[seen] / _STEP for row in rows[1:]]
            jacobian = np.column_stack(columns)
            self._information += jacobian.T @ jacobian
            self._pull += jacobian.T @ apart
            self._count += int(seen.sum())

    # --------------------------------------------------------------------- estimating
    def estimate(self) -> Estimate:
        """Return what is known now; lets the copies catch up with the estimate when it moved.

        Raises
        ------
        NeedleSimError
            When the model cannot follow the commands.
        """
        for _ in range(_ITERATIONS if len(self._steps) >= self._restart_at else 0):
            move = np.linalg.solve(self._information, self._pull)
            largest = float(np.abs(move).max())
            errors = np.sqrt(np.diag(np.linalg.inv(self._information)))
            if (np.abs(move) <= np.maximum(_MOVED, _SURE * errors)).all():
                break
            move *= min(1.0, _LARGEST_MOVE / largest)
            self._reference = self._sensitive(np.clip(self._reference * (1.0 + move), *_BOUNDS))
            self._begin_again()
            self._follow()
            self._restart_at = len(self._steps) + max(_PAUSE, len(self._steps) // 6)
        move = np.linalg.solve(self._information, self._pull)
        values = np.clip(self._reference * (1.0 + move), *_BOUNDS) * self._start
        covariance = np.linalg.inv(self._information)
        errors = np.sqrt(np.diag(covariance)) * self._reference * self._start
        names = [p.name for p in self.parameters]
        time = self._samples[self._taken - 1].time if self._taken else 0.0
        return Estimate(
            time,
            dict(zip(names, values.tolist(), strict=True)),
            dict(zip(names, errors.tolist(), strict=True)),
            self._count,
        )
