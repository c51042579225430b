# SPDX-License-Identifier: Apache-2.0
"""A recorded session read back, whole or cut off; the file is never changed."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session import channels
from needle_sim_ros.session.history import motions_from_json
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.series import Array, Series
from needle_sim_ros.session.writer import ABOUT, HISTORY_FILE, SCENE_FILE

_DAMAGE = (McapError, CRCValidationError, struct.error, zstandard.ZstdError, UnicodeDecodeError)
_LARGEST_RECORD = 1 << 30
_NEEDED = frozenset(
    ("tip_deflection", "tip_pose", "base_wrench", "tissue_markers", "insertion_depth", "process")
)


@dataclass(frozen=True)
class Session:
    """All that a session says.

    Parameters
    ----------
    path : Path
        The MCAP file.
    complete : bool
        Whether the file was finished; otherwise it ends where the writer was killed.
    scene_text : str
        The scene as YAML.
    metadata : mapping of str to str
        Versions, tick period, frames, topics, parameters.
    before : list of (Motion, int), or None
        What was applied before the recording, with numbers of ticks; None when it is
        not known, and the session cannot be replayed from the start.
    motions : list of (int, Motion)
        Log time in ns and motion of every recorded tick.
    events : list of (int, dict)
        Log time in ns and what happened.
    inputs : list of (int, str, message)
        Log time in ns, role and decoded message of every command received.
    series : Series
        The outputs.
    """

    path: Path
    complete: bool
    scene_text: str
    metadata: Mapping[str, str]
    before: list[tuple[Motion, int]] | None
    motions: list[tuple[int, Motion]]
    events: list[tuple[int, dict[str, Any]]]
    inputs: list[tuple[int, str, Any]]
    series: Series


def mcap_path(path: str | Path) -> Path:
    """Return the MCAP file of a session given by its folder or by the file itself.

    Raises
    ------
    SessionError
        When there is none.
    """
    given = Path(path).expanduser()
    if given.is_file():
        return given
    if not given.is_dir():
        raise SessionError(f"{given}: no such session")
    files = sorted(given.glob("*.mcap"))
    if not files:
        raise SessionError(f"{given}: no MCAP file in this folder")
    return files[0]


def read_session(path: str | Path) -> Session:
    """Read a session, or what is there of it when its writer was killed.

    Parameters
    ----------
    path : path
        The session's folder or its MCAP file.

    Raises
    ------
    SessionError
        When it is no session of this package.
    """
    file = mcap_path(path)
    attachments: dict[str, bytes] = {}
    metadata: dict[str, str] = {}
    topics: dict[str, list[tuple[int, Any]]] = {}
    complete = False
    for record in _records(file):
        if isinstance(record, Attachment):
            attachments[record.name] = record.data
        elif isinstance(record, Metadata) and record.name == ABOUT:
            metadata = dict(record.metadata)
        elif isinstance(record, Footer):
            complete = True
        elif isinstance(record, _Decoded):
            topics.setdefault(record.topic, []).append((record.time, record.message))
    if SCENE_FILE not in attachments or not metadata:
        raise SessionError(f"{file}: not a session of needle_sim: it holds no scene")
    try:
        return _session(file, complete, attachments, metadata, topics)
    except (KeyError, ValueError) as error:
        raise SessionError(f"{file} is damaged: {error}") from error


def _session(
    file: Path,
    complete: bool,
    attachments: Mapping[str, bytes],
    metadata: Mapping[str, str],
    topics: Mapping[str, list[tuple[int, Any]]],
) -> Session:
    if sha256(attachments[SCENE_FILE]).hexdigest() != metadata["scene_sha256"]:
        raise SessionError(f"{file} is damaged: the scene is not the one recorded")
    scene_text = attachments[SCENE_FILE].decode()
    roles = {
        channel.role: topics.get(metadata[f"topic.{channel.role}"], [])
        for channel in (*channels.INPUTS, *channels.OUTPUTS, *channels.RECORDS)
    }
    started_late = int(metadata["start_tick"]) > 0
    history = attachments.get(HISTORY_FILE, b"null" if started_late else b"[]")
    motions = [(time, _pose(message)) for time, message in roles["applied_pose"]]
    motions += [(time, _velocity(message)) for time, message in roles["applied_velocity"]]
    inputs = [
        (time, channel.role, message)
        for channel in channels.INPUTS
        for time, message in roles[channel.role]
    ]
    return Session(
        path=file,
        complete=complete,
        scene_text=scene_text,
        metadata=metadata,
        before=motions_from_json(history.decode()),
        motions=sorted(motions, key=_time),
        events=[(time, json.loads(message.data)) for time, message in roles["events"]],
        inputs=sorted(inputs, key=_time),
        series=_series(roles, scene_text, metadata),
    )


@dataclass(frozen=True)
class _Decoded:
    topic: str
    time: int
    message: Any


def _records(file: Path) -> Iterator[McapRecord | _Decoded]:
    """Yield the records of a file, messages decoded, up to where it is cut off."""
    decoders, factory = {}, DecoderFactory()
    footer: Footer | None = None
    schemas: dict[int, Schema] = {}
    try:
        stream = file.open("rb")
    except OSError as error:
        raise SessionError(f"{file}: {error.strerror}") from None
    with stream:
        reader = StreamReader(stream, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        try:
            for record in reader.records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    schema = schemas.get(record.schema_id)
                    decoder = factory.decoder_for(record.message_encoding, schema)
                    decoders[record.id] = (record.topic, decoder)
                elif isinstance(record, Message):
                    topic, decode = decoders[record.channel_id]
                    value = _decoded(decode, record.data)
                    if value is not None:
                        yield _Decoded(topic, record.log_time, value)
                elif isinstance(record, Footer):
                    footer = record
                else:
                    yield record
        except _DAMAGE:
            return
    # Only now is it known that the file ends as it should.
    if footer is not None:
        yield footer


def _decoded(decode: Callable[[bytes], Any] | None, data: bytes) -> Any:
    """Return a message, or None for what is none: others may have sent anything."""
    try:
        return None if decode is None else decode(data)
    except Exception:
        return None


def _time(entry: tuple[Any, ...]) -> int:
    return int(entry[0])


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _xyzw(quaternion: Any) -> list[float]:
    return [quaternion.x, quaternion.y, quaternion.z, quaternion.w]


def _pose(message: Any) -> Motion:
    pose = message.pose
    return Motion.from_values("pose", _xyz(pose.position) + _xyzw(pose.orientation))


def _velocity(message: Any) -> Motion:
    twist = message.twist
    return Motion.from_values("velocity", _xyz(twist.linear) + _xyz(twist.angular))


def _series(
    roles: Mapping[str, list[tuple[int, Any]]], scene_text: str, metadata: Mapping[str, str]
) -> Series:
    """Return the outputs of the ticks of which every one was recorded."""
    table = {channel.role: dict(roles[channel.role]) for channel in channels.OUTPUTS}
    present = [set(messages) for role, messages in table.items() if messages or role in _NEEDED]
    times = sorted(set.intersection(*present))

    def column(role: str, read: Callable[[Any], Any], *width: int) -> Array:
        rows = [read(table[role][time]) for time in times]
        return np.reshape(np.array(rows, dtype=float), (len(times), *width))

    def optional(role: str, read: Callable[[Any], Any], *width: int) -> Array | None:
        return column(role, read, *width) if table[role] else None

    clouds = [_cloud(table["tissue_markers"][time]) for time in times]
    points = np.reshape(np.array(clouds, dtype=float), (len(times), -1 if clouds else 0, 6))
    reference = points[0, :, :3] - points[0, :, 3:] if clouds else np.zeros((0, 3))
    return Series(
        time=np.array(times, dtype=float) * 1e-9,
        insertion_depth=column("insertion_depth", lambda m: m.data),
        base_force=column("base_wrench", lambda m: _xyz(m.wrench.force), 3),
        base_torque=column("base_wrench", lambda m: _xyz(m.wrench.torque), 3),
        tip_position=column("tip_pose", lambda m: _xyz(m.pose.position), 3),
        tip_deflection=column("tip_deflection", lambda m: _xyz(m.vector), 3),
        process=[table["process"][time].data for time in times],
        marker_reference=reference,
        marker_displacements=points[:, :, 3:],
        friction_force=optional("friction_force", lambda m: m.data),
        tip_force=optional("tip_force", lambda m: m.data),
        base_position=optional("stage_pose", lambda m: _xyz(m.pose.position), 3),
        base_orientation=optional("stage_pose", lambda m: _xyzw(m.pose.orientation), 4),
        scene_text=scene_text,
        metadata=metadata,
    )


def _cloud(message: Any) -> NDArray[np.float32]:
    step = message.point_step
    rows = np.frombuffer(bytes(message.data), dtype=np.uint8).reshape(-1, step)[:, :24]
    return np.ascontiguousarray(rows).view("<f4")
