# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 folder: one MCAP file and `metadata.yaml`, as `ros2 bag` writes and reads it."""

from __future__ import annotations

import re
from collections.abc import Sequence
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

    Raises
    ------
    SessionError
        When the folder exists or cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        library = f"needle_sim_ros mcap/{version('mcap')}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise SessionError(f"{folder} exists: a session is never overwritten") from None
        except OSError as error:
            raise SessionError(f"cannot record in {folder}: {error.strerror}") from error
        self.folder = folder
        self._topics: dict[int, dict[str, Any]] = {}
        try:
            self.file = McapFile(folder / f"{folder.name}_0.mcap", library)
        except OSError as error:
            folder.rmdir()
            raise SessionError(f"cannot record in {folder}: {error.strerror}") from error

    def add_topic(self, topic: Topic) -> int:
        """Return the channel id of a new topic."""
        schema = message_schema(topic.type)
        profiles = yaml.safe_dump(topic.qos_profiles(), sort_keys=False)
        metadata = {"offered_qos_profiles": profiles, "topic_type_hash": schema.type_hash}
        channel = self.file.add_channel(topic.name, schema.name, schema.text, metadata)
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
        number = self.file.add_channel(channel.topic, schema.name, text, metadata, encodings)
        profiles = deepcopy(_profiles(metadata.get("offered_qos_profiles", "")))
        known = MessageSchema(schema.name, text, metadata.get("topic_type_hash", ""))
        self._note(number, channel.topic, known, profiles, channel.message_encoding)
        return number

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

    def write(self, entries: Sequence[Entry]) -> None:
        """Write messages as one chunk, all or none; `OSError` when the disk refuses."""
        self.file.write_chunk(entries)

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
            information = self._information()
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

    def _information(self) -> dict[str, Any]:
        first, last = self.file.time_range
        counts = self.file.message_counts
        name = f"{self.folder.name}_0.mcap"
        extent = {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": sum(counts.values()),
        }
        topics = [
            {"topic_metadata": topic, "message_count": counts[channel]}
            for channel, topic in self._topics.items()
        ]
        return {
            "version": _FORMAT_VERSION,
            "storage_identifier": "mcap",
            **_copied(extent),
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [name],
            "files": [{"path": name, **_copied(extent)}],
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


def _copied(extent: dict[str, Any]) -> dict[str, Any]:
    # YAML would write one object met twice as an anchor, which rosbag2 need not read.
    return {key: dict(v) if isinstance(v, dict) else v for key, v in extent.items()}
