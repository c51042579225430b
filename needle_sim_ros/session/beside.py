# SPDX-License-Identifier: Apache-2.0
"""A session with the channels of its replay beside the recorded ones."""

from __future__ import annotations

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
    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.session.replay import Replay

PREFIX = "/replay"
REPLAY_SCENE = "scene_replayed.yaml"
_CHUNK = 2000  # messages


def write_beside(
    folder: Path, content: Content, session: Session, done: Replay, scene: Scene
) -> None:
    """Write a session's own topics, and under `/replay` the simulated ones.

    Parameters
    ----------
    folder : Path
        Made here; must not exist.
    content : Content
        Of the recorded file.
    session : Session
        The same, read.
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
        for name, data in content.attachments.items():
            kind = "application/yaml" if name == SCENE_FILE else "application/octet-stream"
            bag.file.add_attachment(name, kind, data)
        text = scene.to_yaml().encode()
        bag.file.add_attachment(REPLAY_SCENE, "application/yaml", text)
        for name, values in content.metadata.items():
            if name != "rosbag2":  # the new file has its own
                bag.file.add_metadata(name, values)
        about = {"scene": scene.name, "scene_sha256": sha256(text).hexdigest(), **versions(scene)}
        bag.file.add_metadata("needle_sim_ros_replay", about)
        entries = _recorded(bag, content) + _simulated(bag, session, done)
        entries.sort(key=lambda entry: entry[2])
        for start in range(0, len(entries), _CHUNK):
            bag.write(entries[start : start + _CHUNK])
        bag.close()
    except OSError as error:
        bag.file.abandon()
        raise SessionError(f"cannot write {folder}: {error.strerror}") from error


def _recorded(bag: Bag, content: Content) -> list[Entry]:
    entries = []
    for number, channel in content.channels.items():
        schema = content.schemas.get(channel.schema_id)
        if schema is None:
            continue
        copy = bag.copy_topic(channel, schema)
        messages = content.messages.get(number, [])
        entries += [(copy, sequence, time, data) for sequence, time, data in messages]
    return entries


def _simulated(bag: Bag, session: Session, done: Replay) -> list[Entry]:
    entries: list[Entry] = []
    for output in channels.OUTPUTS:
        topic = PREFIX + session.metadata[f"topic.{output.role}"]
        copy = bag.add_topic(Topic(topic, output.type))
        pairs = zip(*done.messages[output.role], strict=True)
        entries += [(copy, k, time, data) for k, (time, data) in enumerate(pairs)]
    return entries
