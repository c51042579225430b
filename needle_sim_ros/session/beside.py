# SPDX-License-Identifier: Apache-2.0
"""A session with the channels of its replay beside the recorded ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session import channels
from needle_sim_ros.session.about import versions
from needle_sim_ros.session.bag import Bag, Topic
from needle_sim_ros.session.mcap_file import Entry
from needle_sim_ros.session.writer import SCENE_FILE

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene
    from needle_sim_ros.session.content import Content
    from needle_sim_ros.session.replay import Replay

PREFIX = "/replay"
REPLAY_SCENE = "scene_replayed.yaml"
_CHUNK = 2000  # messages


def write_beside(
    folder: Path, contents: Sequence[Content], names: Mapping[str, str], done: Replay, scene: Scene
) -> None:
    """Write a bag's own topics, and under `/replay` the simulated ones.

    Parameters
    ----------
    folder : Path
        Made here; must not exist.
    contents : sequence of Content
        Of the recorded file, or of all files of a bag.
    names : mapping of str to str
        Topic names of a session by ``topic.<role>``; those of a node where there are none.
    done : Replay
        What was simulated.
    scene : Scene
        With which; kept as an attachment beside the recorded one.

    Raises
    ------
    SessionError
        When the folder exists or cannot be written.
    """
    bag = Bag(folder)
    try:
        attachments = {k: v for content in contents for k, v in content.attachments.items()}
        for name, data in attachments.items():
            kind = "application/yaml" if name == SCENE_FILE else "application/octet-stream"
            bag.file.add_attachment(name, kind, data)
        text = scene.to_yaml().encode()
        bag.file.add_attachment(REPLAY_SCENE, "application/yaml", text)
        metadata = {k: v for content in contents for k, v in content.metadata.items()}
        for name, values in metadata.items():
            if name != "rosbag2":  # the new file has its own
                bag.file.add_metadata(name, values)
        about = {"scene": scene.name, "scene_sha256": sha256(text).hexdigest(), **versions(scene)}
        bag.file.add_metadata("needle_sim_ros_replay", about)
        copies: dict[tuple[str, str], int] = {}
        entries = [entry for content in contents for entry in _recorded(bag, content, copies)]
        entries += _simulated(bag, names, done)
        entries.sort(key=lambda entry: entry[2])
        for start in range(0, len(entries), _CHUNK):
            bag.write(entries[start : start + _CHUNK])
        bag.close()
    except OSError as error:
        bag.file.abandon()
        raise SessionError(f"cannot write {folder}: {error.strerror}") from error


def _recorded(bag: Bag, content: Content, copies: dict[tuple[str, str], int]) -> list[Entry]:
    """Return the messages of a file; topics that an earlier file of the bag had are joined."""
    entries = []
    for number, channel in content.channels.items():
        schema = content.schemas.get(channel.schema_id)
        if schema is None:
            continue
        topic = (channel.topic, schema.name)
        copy = copies[topic] = copies.get(topic) or bag.copy_topic(channel, schema)
        messages = content.messages.get(number, [])
        entries += [(copy, sequence, time, data) for sequence, time, data in messages]
    return entries


def _simulated(bag: Bag, names: Mapping[str, str], done: Replay) -> list[Entry]:
    entries: list[Entry] = []
    for output in channels.OUTPUTS:
        topic = PREFIX + names.get(f"topic.{output.role}", channels.resolve(output.name))
        copy = bag.add_topic(Topic(topic, output.type))
        pairs = zip(*done.messages[output.role], strict=True)
        entries += [(copy, k, time, data) for k, (time, data) in enumerate(pairs)]
    return entries
