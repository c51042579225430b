# SPDX-License-Identifier: Apache-2.0
"""A recorded session read back, whole or cut off; the file is never changed."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mcap_ros2.decoder import DecoderFactory

from needle_sim_ros.errors import SessionError
from needle_sim_ros.resources import bags_directory
from needle_sim_ros.scene import Scene
from needle_sim_ros.session import channels, decode
from needle_sim_ros.session.attached_mesh import attached_mesh, recorded_scene
from needle_sim_ros.session.channels import Channel
from needle_sim_ros.session.content import Content, read_contents
from needle_sim_ros.session.history import changes_from_json, motions_from_json
from needle_sim_ros.session.mcap_walk import CUT_OFF, NOT_FINISHED
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.series import Array, Series
from needle_sim_ros.session.writer import ABOUT, CHANGES_FILE, HISTORY_FILE, SCENE_FILE

_NEEDED = frozenset(
    ("tip_deflection", "tip_pose", "base_wrench", "tissue_markers", "insertion_depth", "process")
)
_LARGEST_SCENE = 1_000_000  # bytes of YAML, as of a scene's file
# Log times in ns and serialised messages of a topic, by role.
Recorded = Mapping[str, tuple[Sequence[int], Sequence[bytes]]]


@dataclass(frozen=True)
class Session:
    """All that a session says.

    Parameters
    ----------
    path : Path
        The MCAP file; of a session in several files the folder.
    complete : bool
        Whether the file was finished; otherwise it ends where the writer was killed.
    scene_text : str
        The scene as YAML.
    metadata : mapping of str to str
        Versions, tick period, frames, topics, parameters.
    before : list of (Motion, int), or None
        What was applied before the recording, with numbers of ticks; None when it is
        not known, and the session cannot be replayed from the start.
    changes_before : list of (int, dict)
        How the interaction laws changed before the recording: number of ticks before,
        values by keys below `interaction`. Later changes are among the events.
    motions : list of (int, Motion)
        Log time in ns and motion of every recorded tick.
    events : list of (int, dict)
        Log time in ns and what happened.
    inputs : list of (int, str, message)
        Log time in ns, role and decoded message of every command received.
    series : Series
        The outputs.
    tick_times : (k,) array
        Wall-clock time of the recorded ticks, s; empty where they were not recorded.
    mesh : (str, bytes) or None
        Name and content of the mesh file that the tissue is from.
    """

    path: Path
    complete: bool
    scene_text: str
    metadata: Mapping[str, str]
    before: list[tuple[Motion, int]] | None
    changes_before: list[tuple[int, dict[str, float]]]
    motions: list[tuple[int, Motion]]
    events: list[tuple[int, dict[str, Any]]]
    inputs: list[tuple[int, str, Any]]
    series: Series
    tick_times: Array
    mesh: tuple[str, bytes] | None = None

    def scene(self) -> Scene:
        """Return the scene that was recorded, on its recorded mesh."""
        return recorded_scene(self.scene_text, self.mesh)


def mcap_files(path: str | Path) -> list[Path]:
    """Return the MCAP files of a session given by its folder, or by one file alone.

    A bare name that is no file here may be that of a session of this package.

    Raises
    ------
    SessionError
        When there is none.
    """
    given = Path(path).expanduser()
    if not given.exists() and given.name == str(path):
        given = _shipped(given)
    if given.is_file():
        return [given]
    if not given.is_dir():
        raise SessionError(f"{given}: no such session")
    files = sorted(given.glob("*.mcap"), key=_file_order)
    if not files:
        raise SessionError(f"{given}: no MCAP file in this folder")
    return files


def _shipped(name: Path) -> Path:
    """Return the session of this package that has this name, or the name as it is."""
    try:
        found = bags_directory() / name
    except SessionError:
        return name
    return found if found.is_dir() else name


def _file_order(file: Path) -> tuple[int, str]:
    """Order the files of a split bag by the number at the end of their names."""
    number = re.search(r"_(\d{1,18})$", file.stem)
    return (int(number[1]) if number else -1, file.name)


def read_session(path: str | Path) -> Session:
    """Read a session, or what is there of it when its writer was killed.

    Parameters
    ----------
    path : path
        The session's folder, or one MCAP file.

    Raises
    ------
    SessionError
        When it is no session of this package.
    """
    files = mcap_files(path)
    return session_of(bag_path(files), read_contents(files))


def bag_path(files: Sequence[Path]) -> Path:
    """Return what a session is called by: its file, or their folder when it has several."""
    return files[0] if len(files) == 1 else files[0].parent


def session_of(file: Path, content: Content) -> Session:
    """Return the session that the content of its files is; `file` is for messages.

    Raises
    ------
    SessionError
        When it is no session of this package.
    """
    about = content.metadata.get(ABOUT)
    if SCENE_FILE not in content.attachments or not about:
        damage = content.damage
        if damage is not None and damage.reason not in (CUT_OFF, NOT_FINISHED):
            raise SessionError(f"{file} is damaged at byte {damage.offset}: {damage.reason}")
        if not content.messages:
            raise SessionError(f"{file}: it holds no scene and no message: the bag is empty")
        raise SessionError(f"{file}: not a session of needle_sim: it holds no scene")
    if "scene_sha256" not in about:
        raise SessionError(
            f"{file}: recorded before sessions noted the checksum of their scene"
            " (scene_sha256); needle_sim salvage makes a session of it that has one"
        )
    try:
        return _session(file, content, about)
    except KeyError as error:
        raise SessionError(f"{file} is damaged: it does not say its {error}") from error
    except ValueError as error:
        raise SessionError(f"{file} is damaged: {error}") from error


def recorded_messages(content: Content, about: Mapping[str, str]) -> Recorded:
    """Return times and messages of every output, by role; of equal times the last counts."""
    found = {}
    for channel in channels.OUTPUTS:
        messages = content.of_topic(about[f"topic.{channel.role}"], channel.type)
        latest = {time: data for _, time, data in messages}
        found[channel.role] = (list(latest), list(latest.values()))
    return found


def _session(file: Path, content: Content, about: Mapping[str, str]) -> Session:
    scene = content.attachments[SCENE_FILE]
    if len(scene) > _LARGEST_SCENE:
        raise SessionError(f"{file}: its scene is larger than {_LARGEST_SCENE} bytes")
    if sha256(scene).hexdigest() != about["scene_sha256"]:
        raise SessionError(f"{file} is damaged: the scene is not the one recorded")
    started_late = int(about["start_tick"]) > 0
    history = content.attachments.get(HISTORY_FILE, b"null" if started_late else b"[]")

    def messages(channel: Channel) -> tuple[list[int], list[bytes]]:
        found = content.of_topic(about[f"topic.{channel.role}"], channel.type)
        return [time for _, time, _ in found], [data for *_, data in found]

    times, poses = messages(channels.APPLIED_POSE)
    motions = _motions("pose", times, decode.stamped_doubles(poses, 7))
    times, twists = messages(channels.APPLIED_VELOCITY)
    motions += _motions("velocity", times, decode.stamped_doubles(twists, 6))
    times, happened = messages(channels.EVENTS)
    events = [(t, json.loads(e)) for t, e in zip(times, decode.texts(happened), strict=True)]
    scene_text = scene.decode()
    return Session(
        path=file,
        complete=content.damage is None,
        scene_text=scene_text,
        metadata=about,
        before=motions_from_json(history.decode()),
        changes_before=changes_from_json(content.attachments.get(CHANGES_FILE, b"[]").decode()),
        motions=sorted(motions, key=_time),
        events=events,
        inputs=_inputs(content, about),
        series=series_of(recorded_messages(content, about), scene_text, about),
        tick_times=_tick_times(content, about),
        mesh=attached_mesh(content.attachments),
    )


def _motions(
    kind: Literal["pose", "velocity"], times: Sequence[int], rows: Array
) -> list[tuple[int, Motion]]:
    """Return motions from their rows; equal ones, of which a session has many, are one object."""
    known: dict[bytes, Motion] = {}
    motions = []
    for time, row in zip(times, rows, strict=True):
        key = row.tobytes()
        if key not in known:
            known[key] = Motion.from_values(kind, row.tolist())
        motions.append((time, known[key]))
    return motions


def _tick_times(content: Content, about: Mapping[str, str]) -> Array:
    topic = about.get(f"topic.{channels.TICK_TIME.role}")  # older sessions have none
    if topic is None:
        return np.zeros(0)
    found = content.of_topic(topic, channels.TICK_TIME.type)
    return decode.float64s([data for *_, data in found])


def _inputs(content: Content, about: Mapping[str, str]) -> list[tuple[int, str, Any]]:
    """Return the commands as they were received; what is none of them is left out."""
    inputs, factory = [], DecoderFactory()
    for channel in channels.INPUTS:
        topic = about[f"topic.{channel.role}"]
        for number, found in content.channels.items():
            schema = content.schemas.get(found.schema_id)
            if found.topic != topic or schema is None:
                continue
            decoder = factory.decoder_for(found.message_encoding, schema)
            if decoder is None:
                continue
            for _, time, data in content.messages.get(number, []):
                try:
                    inputs.append((time, channel.role, decoder(data)))
                except Exception:  # others may have sent anything
                    continue
    return sorted(inputs, key=_time)


def _time(entry: tuple[Any, ...]) -> int:
    return int(entry[0])


def series_of(
    recorded: Recorded, scene_text: str = "", about: Mapping[str, str] | None = None
) -> Series:
    """Return the outputs of the ticks of which every one is there."""
    present = [times for role, (times, _) in recorded.items() if len(times) or role in _NEEDED]
    times = sorted(set.intersection(*map(set, present)))
    whole = all(len(each) == len(times) and list(each) == times for each in present)

    def rows(role: str) -> Sequence[bytes]:
        if whole:
            return recorded[role][1]
        found = dict(zip(*recorded[role], strict=True))
        return [found[time] for time in times] if found else []

    def has(role: str) -> bool:
        return len(recorded[role][0]) > 0

    def scalar(role: str) -> Array | None:
        return decode.float64s(rows(role)) if has(role) else None

    tip = decode.stamped_doubles(rows("tip_pose"), 7)
    wrench = decode.stamped_doubles(rows("base_wrench"), 6)
    stage = decode.stamped_doubles(rows("stage_pose"), 7) if has("stage_pose") else None
    points = decode.clouds(rows("tissue_markers")).astype(float)
    reference = points[0, :, :3] - points[0, :, 3:] if len(points) else np.zeros((0, 3))
    return Series(
        time=np.array(times, dtype=float) * 1e-9,
        insertion_depth=decode.float64s(rows("insertion_depth")),
        base_force=wrench[:, :3],
        base_torque=wrench[:, 3:],
        tip_position=tip[:, :3],
        tip_deflection=decode.stamped_doubles(rows("tip_deflection"), 3),
        process=decode.texts(rows("process")),
        marker_reference=reference,
        marker_displacements=points[:, :, 3:],
        friction_force=scalar("friction_force"),
        tip_force=scalar("tip_force"),
        base_position=None if stage is None else stage[:, :3],
        base_orientation=None if stage is None else stage[:, 3:],
        tip_orientation=tip[:, 3:],
        scene_text=scene_text,
        metadata=about or {},
    )
