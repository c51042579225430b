# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 folder: MCAP files and `metadata.yaml`, as `ros2 bag` writes and reads it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Schema

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.mcap_file import NO_ROOM, Entry, McapFile
from needle_sim_ros.session.schema import MessageSchema, message_schema

_FORMAT_VERSION = 9  # rosbag2 of Jazzy
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


class FolderTakenError(SessionError):
    """The folder of a new bag exists: a session is never overwritten."""


@dataclass(frozen=True)
class Split:
    """When a bag goes on in another file, as with `ros2 bag record`; 0 is never.

    Parameters
    ----------
    size : float
        Bytes that a file has at least.
    duration : float
        Log time that a file covers at most, s.
    """

    size: float = 0.0
    duration: float = 0.0


NO_SPLIT = Split()


@dataclass(frozen=True)
class _Part:
    """A finished file: name, bytes, first and last log time, messages by channel id."""

    name: str
    size: int
    times: tuple[int, int]
    counts: dict[int, int]


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: resolved name, message type `package/msg/Type`, reliability."""

    name: str
    type: str
    reliability: str = "reliable"
    depth: int = 10

    def qos_profiles(self) -> list[dict[str, Any]]:
        """Return the offered QoS as rosbag2 writes it in metadata version 9."""
        return [
            {
                "history": "keep_last",
                "depth": self.depth,
                "reliability": self.reliability,
                "durability": "volatile",
                "deadline": dict(_FOREVER),
                "lifespan": dict(_FOREVER),
                "liveliness": "automatic",
                "liveliness_lease_duration": dict(_FOREVER),
                "avoid_ros_namespace_conventions": False,
            }
        ]


def new_folder(parent: Path, name: str, now: datetime | None = None) -> Path:
    """Return a folder in `parent` that does not exist yet: name, UTC time, number if taken.

    Parameters
    ----------
    parent : Path
        Need not exist.
    name : str
        What the session is of; characters that file systems dislike are replaced.
    now : datetime, optional
        The time to stamp with.
    """
    stamp = (now or datetime.now(timezone.utc)).strftime("%Y%m%dT%H%M%SZ")
    base = re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("._-") or "session"
    path, number = parent / f"{base}_{stamp}", 1
    while path.exists() or path.is_symlink():
        number += 1
        path = parent / f"{base}_{stamp}_{number}"
    return path


class Bag:
    """A new bag.

    Parameters
    ----------
    folder : Path
        Made here, with its parents; must not exist.
    split : Split
        When to begin another file. Every file has the attachments, the metadata and the
        topics, so that each can be read, or salvaged, by itself.

    Attributes
    ----------
    file : McapFile
        The file that is being written.

    Raises
    ------
    FolderTakenError
        When the folder exists.
    SessionError
        When it cannot be made.
    """

    def __init__(self, folder: Path, split: Split = NO_SPLIT) -> None:
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            text = f"{folder} exists: a session is never overwritten"
            raise FolderTakenError(text) from None
        except OSError as error:
            raise SessionError(f"cannot record in {folder}: {error.strerror}") from error
        self.folder = folder
        self._split = split
        self._parts: list[_Part] = []
        self._topics: dict[int, dict[str, Any]] = {}
        self._channels: list[tuple[str, str, str, dict[str, str], tuple[str, str]]] = []
        self._attachments: list[tuple[str, str, bytes]] = []
        self._metadata: list[tuple[str, Mapping[str, str]]] = []
        try:
            self.file = self._opened(0)
        except OSError as error:
            folder.rmdir()
            raise SessionError(f"cannot record in {folder}: {error.strerror}") from error

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return self.file.size + sum(part.size for part in self._parts)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment into every file; only before the first message."""
        self.file.add_attachment(name, media_type, data)
        self._attachments.append((name, media_type, data))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record into every file; only before the first message."""
        self.file.add_metadata(name, values)
        self._metadata.append((name, values))

    def add_topic(self, topic: Topic) -> int:
        """Return the channel id of a new topic."""
        schema = message_schema(topic.type)
        profiles = yaml.safe_dump(topic.qos_profiles(), sort_keys=False)
        metadata = {"offered_qos_profiles": profiles, "topic_type_hash": schema.type_hash}
        channel = self._add_channel(
            topic.name, schema.name, schema.text, metadata, ("cdr", "ros2msg")
        )
        self._note(channel, topic.name, schema, topic.qos_profiles())
        return channel

    def copy_topic(self, channel: Channel, schema: Schema) -> int:
        """Return the channel id of a topic that is as in another file.

        Raises
        ------
        UnicodeDecodeError
            When the schema is no text.
        """
        text = schema.data.decode()
        encodings = (channel.message_encoding, schema.encoding)
        metadata = dict(channel.metadata)
        number = self._add_channel(channel.topic, schema.name, text, metadata, encodings)
        profiles = deepcopy(_profiles(metadata.get("offered_qos_profiles", "")))
        known = MessageSchema(schema.name, text, metadata.get("topic_type_hash", ""))
        self._note(number, channel.topic, known, profiles, channel.message_encoding)
        return number

    def _add_channel(
        self, topic: str, kind: str, text: str, metadata: dict[str, str], encodings: tuple[str, str]
    ) -> int:
        self._channels.append((topic, kind, text, metadata, encodings))
        return self.file.add_channel(topic, kind, text, metadata, encodings)

    def _note(
        self,
        channel: int,
        topic: str,
        schema: MessageSchema,
        profiles: list[dict[str, Any]],
        serialization: str = "cdr",
    ) -> None:
        self._topics[channel] = {
            "name": topic,
            "type": schema.name,
            "serialization_format": serialization,
            "offered_qos_profiles": profiles,
            "type_description_hash": schema.type_hash,
        }

    def pieces(self, entries: Sequence[Entry]) -> Iterator[Sequence[Entry]]:
        """Yield entries in parts that belong into one file each; write each before the next."""
        limit = round(self._split.duration * 1e9)
        while entries:
            count = len(entries)
            if limit:
                start = self.file.start
                first = entries[0][2]
                if start is None or first - start >= limit:
                    start = first
                count = next((k for k, e in enumerate(entries) if e[2] - start >= limit), count)
            yield entries[:count]
            entries = entries[count:]

    def write(self, entries: Sequence[Entry], pause: Callable[[], object] = lambda: None) -> None:
        """Write messages as one chunk, all or none; `OSError` when the disk refuses.

        `pause` is as in :meth:`McapFile.write_chunk`.
        """
        if entries and self._is_full(entries[0][2]):
            self._begin_file()
        self.file.write_chunk(entries, pause)

    def _is_full(self, time: int) -> bool:
        start, split = self.file.start, self._split
        if start is None:
            return False
        return (0 < split.size <= self.file.size) or (
            split.duration > 0 and time - start >= round(split.duration * 1e9)
        )

    def _begin_file(self) -> None:
        """Go on in another file; where there is no room for that, in this one."""
        number = len(self._parts) + 1
        try:
            following = self._opened(number)
        except OSError:
            return
        part = self._part()
        try:
            for channel in self._channels:
                following.add_channel(*channel)
            for attachment in self._attachments:
                following.add_attachment(*attachment)
            for metadata in self._metadata:
                following.add_metadata(*metadata)
            self.file.finish(
                lambda: ("rosbag2", {"serialized_metadata": _yaml(self._information([part]))}),
                make_room=False,
            )
        except OSError:
            following.abandon()
            (self.folder / self._name(number)).unlink(missing_ok=True)
            return
        self._parts.append(part)
        self.file = following

    def _opened(self, number: int) -> McapFile:
        library = f"needle_sim_ros mcap/{version('mcap')}"
        return McapFile(self.folder / self._name(number), library)

    def _name(self, number: int) -> str:
        return f"{self.folder.name}_{number}.mcap"

    def _part(self) -> _Part:
        file = self.file
        name = self._name(len(self._parts))
        return _Part(name, file.size, file.time_range, file.message_counts)

    def close(self) -> int:
        """Finish file and `metadata.yaml`; return how many messages had to make room.

        Raises
        ------
        OSError
            When there is no room at all; what was written stays readable.
        """
        target = self.folder / "metadata.yaml"
        failure: OSError | None = None

        def closing() -> tuple[str, dict[str, str]]:
            nonlocal failure
            information = self._information([*self._parts, self._part()])
            text = _yaml({"rosbag2_bagfile_information": information})
            try:
                target.write_text(text, encoding="utf-8")
            except OSError as error:
                # Messages make room for it; for other reasons the MCAP file goes without.
                if error.errno in NO_ROOM:
                    raise
                failure = error
            return "rosbag2", {"serialized_metadata": _yaml(information)}

        try:
            dropped = self.file.finish(closing)
        except OSError:
            self.file.abandon()
            target.unlink(missing_ok=True)
            raise
        if failure is not None:
            raise failure
        return dropped

    def _information(self, parts: Sequence[_Part]) -> dict[str, Any]:
        filled = [part.times for part in parts if any(part.counts.values())] or [(0, 0)]
        total = sum(sum(part.counts.values()) for part in parts)
        extent = _extent(min(t[0] for t in filled), max(t[1] for t in filled), total)
        topics = [
            {
                "topic_metadata": topic,
                "message_count": sum(part.counts.get(channel, 0) for part in parts),
            }
            for channel, topic in self._topics.items()
        ]
        return {
            "version": _FORMAT_VERSION,
            "storage_identifier": "mcap",
            **extent,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [part.name for part in parts],
            "files": [
                {"path": part.name, **_extent(*part.times, sum(part.counts.values()))}
                for part in parts
            ],
            "custom_data": None,
            "ros_distro": "jazzy",
        }


def _yaml(data: dict[str, Any]) -> str:
    # libyaml, where PyYAML has it, takes a tenth of the time
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    text: str = yaml.dump(data, Dumper=dumper, sort_keys=False)
    return text


@cache
def _profiles(text: str) -> list[dict[str, Any]]:
    """Return QoS profiles from their YAML; none from what is not YAML."""
    try:
        found = yaml.safe_load(text)
    except yaml.YAMLError:
        return []
    return found if isinstance(found, list) else []


def _extent(first: int, last: int, count: int) -> dict[str, Any]:
    # Made anew each time: YAML would write one object met twice as an anchor.
    return {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": last - first},
        "message_count": count,
    }
