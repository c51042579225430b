# SPDX-License-Identifier: Apache-2.0
"""An experiment: what the base did, tick by tick, and what was measured meanwhile.

Made of a session of this package or of any bag whose topics are mapped; replay and
identification know nothing else. Times count from the start of the simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.errors import SceneError, SessionError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.attached_mesh import recorded_scene
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.reader import Session
from needle_sim_ros.session.replay import Tick, replay_ticks
from needle_sim_ros.session.series import Series
from needle_sim_ros.session.writer import BASE_FRAME, TISSUE_FRAME

UNITS = {"force": "N", "torque": "N m", "markers": "m", "tip": "m"}


def begun_at(scene: Scene, position: Sequence[float], orientation: Sequence[float]) -> Scene:
    """Return a scene whose base begins elsewhere, m and quaternion x y z w.

    Its own protocol is left out where it cannot be carried out from there: what moves the base
    in an experiment are the commands that were recorded.
    """
    changes: dict[str, object] = {
        "base.position": list(position),
        "base.orientation": list(orientation),
    }
    try:
        return scene.with_changes(changes)
    except SceneError:
        return scene.with_changes({**changes, "protocol": []})


@dataclass(frozen=True, eq=False)
class Measured:
    """One quantity at times of its own.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s, ascending.
    values : ndarray, shape (n, ...)
        Force and torque (n, 3), base frame, as the simulator's; marker displacements
        (n, m, 3) and tip positions (n, 3), tissue frame. NaN where nothing was seen.
    """

    time: Vector
    values: Vector

    def at(self, rows: NDArray[np.bool_]) -> Measured:
        """Return some of the rows."""
        return Measured(self.time[rows], self.values[rows])


@dataclass(frozen=True, eq=False)
class Experiment:
    """What was done and what was seen.

    Attributes
    ----------
    name : str
    tick_period : float
        s.
    motions : list of Motion
        One for each tick from the start.
    measured : mapping of str to Measured
        ``force``, ``torque``, ``markers``, ``tip``: those that there are.
    scene_text : str
        The scene in the bag; empty when there is none.
    mesh : (str, bytes) or None
        Name and bytes of its mesh file, where the bag holds it.
    start : tuple or None
        Position and quaternion of the base at the start, when not the scene's.
    markers : ndarray (m, 3) or None
        Markers at rest, when not the scene's.
    begin : int
        Log time of the start, ns.
    notes : tuple of str
        What had to be made up or left out.
    """

    name: str
    tick_period: float
    motions: list[Motion]
    measured: Mapping[str, Measured]
    scene_text: str = ""
    mesh: tuple[str, bytes] | None = field(default=None, repr=False)
    start: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    markers: Vector | None = None
    begin: int = 0
    notes: tuple[str, ...] = ()
    recorded: Series | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.motions)

    def scene(self, given: Scene | None = None) -> Scene:
        """Return the scene to simulate: the one given or the bag's, with base and markers.

        Raises
        ------
        SessionError
            When there is none.
        """
        if given is None:
            if not self.scene_text:
                raise SessionError(f"{self.name}: the bag holds no scene: give one with --scene")
            given = recorded_scene(self.scene_text, self.mesh)
        if self.markers is not None:
            given = given.with_changes({"markers": self.markers.tolist()})
        return given if self.start is None else begun_at(given, *self.start)

    @property
    def ends(self) -> Vector:
        """Times at which ticks end, and the start, s, (ticks + 1,)."""
        return np.asarray(self.tick_period * np.arange(len(self.motions) + 1))

    @property
    def about(self) -> dict[str, str]:
        """What a replay has to know, as sessions say it about themselves."""
        return {
            "tick_period": repr(self.tick_period),
            "tissue_frame": TISSUE_FRAME,
            "base_frame": BASE_FRAME,
        }

    def ticks(self) -> list[Tick]:
        """Return the ticks as a replay takes them, with log times."""
        period = self.tick_period * 1e9
        return [Tick(m, self.begin + round((k + 1) * period)) for k, m in enumerate(self.motions)]

    def coarser(self, rate: float) -> Experiment:
        """Return the experiment with ticks joined, so that there are about `rate` a second."""
        count = round(1.0 / (rate * self.tick_period))
        if count <= 1:
            return self
        rows = range(0, len(self.motions), count)
        motions = [joined(self.motions[k : k + count], count) for k in rows]
        return replace(self, tick_period=count * self.tick_period, motions=motions)


def interpolated(times: Vector, known: Vector, rows: Vector) -> Vector:
    """Return rows (n, ...), known at ascending times, at other times; linear between."""
    if len(known) == 1:
        return np.repeat(rows, len(times), axis=0)
    after = np.clip(np.searchsorted(known, times), 1, len(known) - 1)
    part = (times - known[after - 1]) / (known[after] - known[after - 1])
    part = np.clip(part, 0.0, 1.0).reshape(-1, *[1] * (rows.ndim - 1))
    # a tick's own time gives its row, whatever rounding does to the quotient
    part = np.where(np.abs(part - np.round(part)) < 1e-6, np.round(part), part)
    return np.asarray(rows[after - 1] + part * (rows[after] - rows[after - 1]))


def joined(motions: Sequence[Motion], count: int) -> Motion:
    """Return one motion for several ticks: their mean velocity, or the last pose."""
    if len({m.kind for m in motions}) > 1:
        raise SessionError(
            "ticks with poses and with velocities cannot be joined: leave out --rate"
        )
    last = motions[-1]
    if last.kind == "pose" or (all(m == last for m in motions) and len(motions) == count):
        return last
    rows = np.nan_to_num(np.array([m.values() for m in motions]))
    return Motion.from_values("velocity", (rows.sum(axis=0) / count).tolist())


def of_session(session: Session, name: str = "") -> Experiment:
    """Return the longest stretch between resets of a session of this package.

    Raises
    ------
    SessionError
        When no tick's motion was recorded.
    """
    ticks = replay_ticks(session)
    starts = [0, *(k for k, tick in enumerate(ticks) if tick.reset and k), len(ticks)]
    begin, end = max(pairwise(starts), key=lambda pair: pair[1] - pair[0])
    chosen = ticks[begin:end]
    notes = []
    if len(starts) > 2:
        notes.append("Of the stretches between resets the longest was taken.")
    held = sum(tick.held for tick in chosen)
    if held:
        notes.append(f"The commands of {held} ticks are lost; the one before was held.")
    period = float(session.metadata["tick_period"])
    k, logged = next(
        ((k, t.log_time) for k, t in enumerate(chosen) if t.log_time is not None), (0, 0)
    )
    first = int(logged or 0) - round((k + 1) * period * 1e9)
    return Experiment(
        name=name or session.path.stem,
        tick_period=period,
        motions=[tick.motion for tick in chosen],
        measured=_outputs(session.series, len(chosen) * period, begin == 0 and len(starts) == 2),
        scene_text=session.scene_text,
        mesh=session.mesh,
        begin=first,
        notes=tuple(notes),
        recorded=session.series,
    )


def _outputs(series: Series, end: float, whole: bool) -> dict[str, Measured]:
    """Return the outputs of a session as if they were measured."""
    rows = np.arange(len(series))
    if not whole:  # stamps start again with a reset: take the last run of ascending ones
        turns = np.flatnonzero(np.diff(series.time) <= 0) + 1
        parts = np.split(rows, turns)
        rows = max(parts, key=len)
    rows = rows[series.time[rows] <= end * (1 + 1e-9)]
    time = series.time[rows]
    found = {
        "force": Measured(time, series.base_force[rows]),
        "torque": Measured(time, series.base_torque[rows]),
        "tip": Measured(time, series.tip_position[rows]),
    }
    if len(series.marker_reference):
        found["markers"] = Measured(time, series.marker_displacements[rows])
    return found if len(rows) else {}
