# SPDX-License-Identifier: Apache-2.0
"""A table of measurements written as a session, which replay and identification read."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needle_sim_ros.errors import SessionError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Scene
from needle_sim_ros.session import cdr, channels
from needle_sim_ros.session.about import versions
from needle_sim_ros.session.bag import Bag, Topic
from needle_sim_ros.session.channels import Channel
from needle_sim_ros.session.experiment import begun_at
from needle_sim_ros.session.frames import poses_at
from needle_sim_ros.session.mapping import Mapping as TopicMapping
from needle_sim_ros.session.mapping import TopicMap
from needle_sim_ros.session.mcap_file import Entry
from needle_sim_ros.session.writer import ABOUT, BASE_FRAME, SCENE_FILE, TISSUE_FRAME

if TYPE_CHECKING:
    from needle_sim_ros.session.content import Content

_CHUNK = 2000  # messages
_DOWN = (1.0, 0.0, 0.0, 0.0)
_ROLES = {
    "wrench": channels.BASE_WRENCH,
    "markers": channels.TISSUE_MARKERS,
    "tip_pose": channels.TIP_POSE,
}


def is_imported(content: Content) -> bool:
    """Whether a file was made by :func:`write_imported`."""
    return content.metadata.get(ABOUT, {}).get("source") == "import"


def imported_mapping(content: Content) -> TopicMapping:
    """Return where the measurements are in an imported file."""
    names = {c.topic for n, c in content.channels.items() if content.messages.get(n)}
    topics = {role: channels.resolve(channel.name) for role, channel in _ROLES.items()}
    found: dict[str, Any] = {r: TopicMap(name) for r, name in topics.items() if name in names}
    command = TopicMap(channels.resolve(channels.BASE_POSE.name))
    return TopicMapping(base_pose=command, clock="log", **found)


def write_imported(
    folder: Path, table: Mapping[str, Vector], scene: Scene | None, period: float
) -> dict[str, int]:
    """Write a table as a session.

    Parameters
    ----------
    folder : Path
        Made here; must not exist.
    table : mapping
        See :func:`~needle_sim_ros.session.csv_table.read_table`; needs a base position.
    scene : Scene, optional
        Kept in the session with the base where the table starts; without one the bag holds
        the measurements alone.
    period : float
        Tick of the commands, s.

    Returns
    -------
    dict of str to int
        Messages by topic.

    Raises
    ------
    SessionError
        When the base position is missing or the folder cannot be written.
    """
    time = table["time"] - table["time"][0]
    poses = _poses(table, scene)
    written: list[tuple[Channel, list[tuple[int, bytes]]]] = []
    stamps = np.round(time * 1e9).astype(np.int64).tolist()
    pose = cdr.stamped_doubles(TISSUE_FRAME, 7)
    written.append((channels.BASE_POSE, _rows(stamps, poses, pose)))
    ends = np.arange(1, round(time[-1] / period) + 1) * period
    applied = poses_at(ends, time, poses)
    at = np.round(ends * 1e9).astype(np.int64).tolist()
    written.append((channels.APPLIED_POSE, _rows(at, applied, pose)))
    wrench = np.hstack([_triple(table, "base_force"), _triple(table, "base_torque")])
    if np.isfinite(wrench).any():
        encode = cdr.stamped_doubles(BASE_FRAME, 6)
        written.append((channels.BASE_WRENCH, _rows(stamps, wrench, encode)))
    tip = _triple(table, "tip_position")
    if np.isfinite(tip).any():
        rows = np.hstack([tip, np.tile(_DOWN, (len(tip), 1))])
        written.append((channels.TIP_POSE, _rows(stamps, rows, pose)))
    markers = _markers(table)
    if markers.shape[1]:
        cloud = cdr.marker_cloud(TISSUE_FRAME)
        moved = markers - markers[0]
        seen = [(t, cloud(t, p, d)) for t, p, d in zip(stamps, markers, moved, strict=True)]
        written.append((channels.TISSUE_MARKERS, seen))
    if scene is not None:
        scene = begun_at(scene, poses[0, :3].tolist(), poses[0, 3:].tolist())
    _write(folder, written, scene, period)
    return {channels.resolve(channel.name): len(rows) for channel, rows in written}


def _rows(stamps: list[int], rows: Vector, encode: cdr.Packer) -> list[tuple[int, bytes]]:
    return [(t, encode(t, row)) for t, row in zip(stamps, rows.tolist(), strict=True)]


def _triple(table: Mapping[str, Vector], name: str) -> Vector:
    lacking = np.full(len(table["time"]), np.nan)
    return np.column_stack([table.get(f"{name}.{axis}", lacking) for axis in "xyz"])


def _poses(table: Mapping[str, Vector], scene: Scene | None) -> Vector:
    place = _triple(table, "base_position")
    if not np.isfinite(place).any():
        raise SessionError("no base_position in the table: nothing says what the base did")
    for axis in range(3):
        if not np.isfinite(place[:, axis]).any():
            place[:, axis] = 0.0 if scene is None else (scene.base.position or (0.0,) * 3)[axis]
    given = [table.get(f"base_orientation.{axis}") for axis in "xyzw"]
    if all(g is None for g in given):
        turned = np.tile(_DOWN if scene is None else scene.base.orientation, (len(place), 1))
    elif any(g is None for g in given):
        raise SessionError("base_orientation: x, y, z and w are needed")
    else:
        turned = np.column_stack([g for g in given if g is not None])
    poses = np.hstack([place, turned])
    whole = np.isfinite(poses).all(axis=1) & (np.linalg.norm(turned, axis=1) > 1e-6)
    if not whole[0]:
        raise SessionError("row 1: the base has no pose there")
    time = table["time"]
    return poses_at(time, time[whole], poses[whole])


def _markers(table: Mapping[str, Vector]) -> Vector:
    numbers = sorted({int(name.split(".")[1]) for name in table if name.startswith("marker.")})
    if not numbers:
        return np.zeros((len(table["time"]), 0, 3))
    found = np.stack([_triple(table, f"marker.{number}") for number in numbers], axis=1)
    for axis in range(3):  # a plane of markers: the coordinate that nobody measured is zero
        if not np.isfinite(found[..., axis]).any():
            found[..., axis] = 0.0
    return found


def _write(
    folder: Path,
    written: list[tuple[Channel, list[tuple[int, bytes]]]],
    scene: Scene | None,
    period: float,
) -> None:
    everything = (*channels.INPUTS, *channels.OUTPUTS, *channels.RECORDS)
    about = {
        "source": "import",
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "tick_period": repr(period),
        "start_tick": "0",
        "tissue_frame": TISSUE_FRAME,
        "base_frame": BASE_FRAME,
        **versions(),
        **{f"topic.{c.role}": channels.resolve(c.name) for c in everything},
    }
    bag = Bag(folder)
    try:
        if scene is not None:
            text = scene.to_yaml().encode()
            about |= {"scene": scene.name, "scene_sha256": sha256(text).hexdigest()}
            bag.file.add_attachment(SCENE_FILE, "application/yaml", text)
        bag.file.add_metadata(ABOUT, about)
        entries: list[Entry] = []
        for channel, rows in written:
            number = bag.add_topic(Topic(channels.resolve(channel.name), channel.type))
            entries += [(number, k, time, data) for k, (time, data) in enumerate(rows)]
        entries.sort(key=lambda entry: entry[2])
        for start in range(0, len(entries), _CHUNK):
            bag.write(entries[start : start + _CHUNK])
        bag.close()
    except OSError as error:
        bag.file.abandon()
        raise SessionError(f"cannot write {folder}: {error.strerror}") from error
