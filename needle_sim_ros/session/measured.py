# SPDX-License-Identifier: Apache-2.0
"""Rows of mapped topics in the model's frames: commands on ticks, measurements at their times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.errors import SessionError
from needle_sim_ros.geometry import Vector, conjugate, multiply, rotation_matrix
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.experiment import Experiment, Measured
from needle_sim_ros.session.frames import Transform, poses_at
from needle_sim_ros.session.mapping import COMMAND, MARKERS, TIP, WRENCH, TopicMap
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.topics import TopicData

_MOST_TICKS = 10_000_000
_LONG_GAP = 0.1  # s
Start = tuple[tuple[float, ...], tuple[float, ...]]


def commanded(
    data: TopicData, time: Vector, mapped: TopicMap, scene: Scene, period: float
) -> tuple[list[Motion], Start | None, list[str]]:
    """Return the motion of every tick, where the base starts, and notes.

    Poses and joint positions are interpolated, velocities held until the next message.

    Parameters
    ----------
    data : TopicData
    time : ndarray, shape (n,)
        Of its rows, s, the first at zero.
    mapped : TopicMap
    scene : Scene
    period : float
        Tick, s.
    """
    if not np.isfinite(data.rows).all():
        raise SessionError(f"topic {mapped.topic}: it holds numbers that are not finite")
    ticks = round(time[-1] / period) + (data.rows.shape[1] == 6)
    if not 1 <= ticks <= _MOST_TICKS:
        raise SessionError(
            f"topic {mapped.topic}: its {len(time)} messages span {time[-1]:g} s, or {ticks} ticks"
            f" of {period:g} s: must be 1 to {_MOST_TICKS}"
        )
    notes = _gaps(time, mapped.topic)
    ends = period * np.arange(ticks + 1)
    if data.rows.shape[1] == 6:
        return _velocities(data.rows, time, mapped, ends, scene), None, notes
    if data.rows.shape[1] == 1:
        poses = _joint_poses(data.rows[:, 0], mapped, scene)
    else:
        moving = mapped.transform.transform().poses(data.rows)
        tool = mapped.tool.transform()
        poses = moving if tool.is_identity else inverse(tool).after(moving)
    path = poses_at(ends, time, poses)
    if scene.dimension == 2:
        path, off = _in_plane(path)
        if off > 1e-3:
            notes.append(
                f"The base leaves the plane of the 2D scene by up to {1e3 * off:.2g} mm: left out."
            )
    rows = path.tolist()
    motions = [Motion("pose", tuple(row[:3]), tuple(row[3:])) for row in rows[1:]]
    return motions, (tuple(rows[0][:3]), tuple(rows[0][3:])), notes


def inverse(transform: Transform) -> Transform:
    """Return the transform back."""
    back = conjugate(transform.rotation)
    place = -rotation_matrix(back) @ np.array(transform.translation)
    return Transform(tuple(place.tolist()), tuple(back.tolist()))


def _gaps(time: Vector, topic: str) -> list[str]:
    steps = np.diff(time)
    if len(steps) < 3:
        return []
    long = steps > max(_LONG_GAP, 5 * float(np.median(steps)))
    if not long.any():
        return []
    return [f"{long.sum()} gaps in {topic}, of up to {steps.max():.2g} s, were bridged."]


def _velocities(
    rows: Vector, time: Vector, mapped: TopicMap, ends: Vector, scene: Scene
) -> list[Motion]:
    """Return the mean velocity over each tick, of velocities held until the next message."""
    turned = mapped.transform.transform()
    twists = np.hstack([turned.vectors(rows[:, :3]), turned.vectors(rows[:, 3:])])
    if scene.dimension == 2:
        twists[:, [1, 3, 5]] = 0.0
    spans = np.diff(np.append(time, max(ends[-1], time[-1])))
    way = np.vstack([np.zeros(6), np.cumsum(twists * spans[:, None], axis=0)])
    at = np.append(time, time[-1] + spans[-1])
    reached = np.column_stack([np.interp(ends, at, way[:, k]) for k in range(6)])
    means = np.diff(reached, axis=0) / np.diff(ends)[:, None]
    return [Motion("velocity", tuple(row[:3]), tuple(row[3:])) for row in means.tolist()]


def _joint_poses(positions: Vector, mapped: TopicMap, scene: Scene) -> Vector:
    axis = mapped.transform.transform().vectors(np.array(mapped.axis))
    zero = positions[0] if mapped.zero is None else mapped.zero
    place = np.array(scene.base.position) + (positions - zero)[:, None] * axis
    turned = np.array(scene.base.orientation)
    return np.column_stack([place, np.tile(turned / np.linalg.norm(turned), (len(place), 1))])


def _in_plane(path: Vector) -> tuple[Vector, float]:
    """Return poses with the needle in the plane y = 0, and how far the base was beside it."""
    flat = path.copy()
    off = float(np.abs(path[:, 1]).max())
    flat[:, 1] = 0.0
    known: dict[tuple[float, ...], list[float]] = {}
    for k, quaternion in enumerate(map(tuple, path[:, 3:].tolist())):
        if quaternion not in known:
            axis = rotation_matrix(quaternion)[:, 2]
            half = 0.5 * float(np.arctan2(axis[0], axis[2]))
            level = np.array([0.0, np.sin(half), 0.0, np.cos(half)])
            # about z by half a turn where the base's x points the other way
            front = rotation_matrix(quaternion)[:, 0] @ rotation_matrix(level)[:, 0] >= 0
            turned = level if front else multiply(level, [0.0, 0.0, 1.0, 0.0])
            known[quaternion] = turned.tolist()
        flat[k, 3:] = known[quaternion]
    return flat, off


def with_measured(
    experiment: Experiment,
    data: Mapping[str, TopicData],
    roles: Mapping[str, TopicMap],
    times: Mapping[str, NDArray[np.int64]],
    begin: int,
    scene: Scene | None,
) -> Experiment:
    """Return an experiment with what mapped topics measured in place of what it had.

    Parameters
    ----------
    experiment : Experiment
    data, roles, times : mapping
        Rows, topics and times in ns, by role.
    begin : int
        Time of the start by the same clock, ns.
    scene : Scene, optional
        The one that is simulated, when not the bag's.
    """
    found = dict(experiment.measured)
    markers, notes = experiment.markers, list(experiment.notes)
    flat = bool(data) and experiment.scene(scene).dimension == 2
    end = experiment.tick_period * (len(experiment) + 0.5)
    for role, topic in data.items():
        time = np.asarray((times[role] - begin) * 1e-9, dtype=float)
        mapped = roles[role]
        rows = topic.rows
        within = (time >= 0) & (time <= end)
        if role == WRENCH:
            wrenches = _wrenches(rows, time, mapped)
            found["force"] = Measured(time, wrenches[:, :3]).at(within)
            found["torque"] = Measured(time, wrenches[:, 3:]).at(within)
        elif role == TIP:
            poses = mapped.transform.transform().poses(rows)
            tool = mapped.tool.transform()
            place = poses if tool.is_identity else inverse(tool).after(poses)
            found["tip"] = Measured(time, place[:, :3]).at(within)
        elif role == MARKERS:
            points = mapped.transform.transform().points(rows)
            if flat:
                points[..., 1] = np.where(np.isnan(points[..., 1]), np.nan, 0.0)
            markers, moved, lost = _displacements(points, time, mapped)
            if lost:
                notes.append(f"{lost} markers were not seen at rest and are left out.")
            found["markers"] = Measured(time, moved).at(within)
        if role != COMMAND and not within.any():
            raise SessionError(
                f"topic {mapped.topic}: none of its times lies within the commands'"
                " (`clock: log` in the mapping goes by the recorder's clock)"
            )
    return replace(experiment, measured=found, markers=markers, notes=tuple(notes))


def _wrenches(rows: Vector, time: Vector, mapped: TopicMap) -> Vector:
    bias = np.zeros(6)
    if mapped.bias_time > 0:
        first = rows[time - time[0] <= mapped.bias_time]
        bias = np.nanmean(first, axis=0)
    else:
        bias[: len(mapped.bias)] = mapped.bias
    turned = mapped.transform.transform().wrenches(mapped.sign * (rows - bias))
    if mapped.axes != "xyz":
        turned[:, [k for k, axis in enumerate("xyz") if axis not in mapped.axes]] = np.nan
        turned[:, 3:] = np.nan
    return turned


def _displacements(points: Vector, time: Vector, mapped: TopicMap) -> tuple[Vector, Vector, int]:
    """Return markers at rest, their displacements, and how many were never seen at rest."""
    early = points[time - time[0] <= mapped.reference_time]
    seen = np.isfinite(early).all(axis=2).any(axis=0)
    if not seen.any():
        raise SessionError(
            f"topic {mapped.topic}: no marker in its first {mapped.reference_time:g} s"
            " (reference_time in the mapping)"
        )
    rest = np.nanmean(early[:, seen], axis=0)
    return rest, points[:, seen] - rest, int((~seen).sum())
