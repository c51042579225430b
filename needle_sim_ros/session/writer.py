# SPDX-License-Identifier: Apache-2.0
"""A session being written: topics, scene and what a replay needs, in one recorder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session import channels
from needle_sim_ros.session.about import versions
from needle_sim_ros.session.attached_mesh import mesh_attachment
from needle_sim_ros.session.bag import NO_SPLIT, Bag, Split, Topic
from needle_sim_ros.session.channels import Channel
from needle_sim_ros.session.encoding import (
    TICK_TIME_ENCODERS,
    Encoders,
    motion_encoders,
    output_encoders,
)
from needle_sim_ros.session.history import History
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.recorder import Recorder, RecorderStatus

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.scene import Scene

ABOUT = "needle_sim_ros"
SCENE_FILE = "scene.yaml"
HISTORY_FILE = "commands_before.json"
CHANGES_FILE = "changes_before.json"
TISSUE_FRAME, BASE_FRAME = "tissue", "needle_base"


def nanoseconds(time: float) -> int:
    """Return a simulated time in s as a stamp in ns."""
    return round(time * 1e9)


class SessionWriter:
    """Records one session; see `bags/README.md` for the format.

    Parameters
    ----------
    folder : Path
        Made here; must not exist.
    scene : Scene
        What is simulated, with every override applied, as it was when the simulation
        started.
    tick_period : float
        The dt of every tick, s.
    names : mapping of Channel to str, optional
        Resolved topic names; by default those of a node without remappings.
    tissue_frame, base_frame : str
        Frame ids.
    settings : mapping, optional
        More for the session to say about itself.
    split : Split
        When to go on in another file.
    begin : bool
        Whether the simulation is at its start, so that messages may follow at once;
        otherwise :meth:`begin` comes first.
    give_way : callable
        As the recorder's.

    Raises
    ------
    FolderTakenError
        When the folder exists.
    SessionError
        When it cannot be written, or ROS messages are not installed.
    """

    def __init__(
        self,
        folder: Path,
        scene: Scene,
        tick_period: float,
        *,
        names: Mapping[Channel, str] | None = None,
        tissue_frame: str = TISSUE_FRAME,
        base_frame: str = BASE_FRAME,
        settings: Mapping[str, str] | None = None,
        split: Split = NO_SPLIT,
        begin: bool = True,
        give_way: Callable[[], object] = lambda: None,
    ) -> None:
        self.folder = folder
        self._give_way = give_way
        self._encoders = output_encoders(tissue_frame, base_frame)
        self._motion_encoders = motion_encoders(tissue_frame)
        everything = (*channels.INPUTS, *channels.OUTPUTS, *channels.RECORDS)
        topics = {c: (names or {}).get(c) or channels.resolve(c.name) for c in everything}
        scene_text = scene.to_yaml().encode()
        mesh = mesh_attachment(scene)
        self._about = {
            "scene": scene.name,
            "scene_sha256": sha256(scene_text).hexdigest(),
            "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "tick_period": repr(tick_period),
            "tissue_frame": tissue_frame,
            "base_frame": base_frame,
            **versions(scene),
            **(settings or {}),
            **{f"topic.{channel.role}": name for channel, name in topics.items()},
        }
        self._bag = bag = Bag(folder, split)
        try:
            bag.add_attachment(SCENE_FILE, "application/yaml", scene_text)
            if mesh is not None:
                bag.add_attachment(mesh[0], "application/octet-stream", mesh[1])
            self._numbers: dict[Encoders, list[int]] = {}  # of the channels of each
            self._ids = {c: bag.add_topic(Topic(name, c.type)) for c, name in topics.items()}
        except OSError as error:
            bag.file.abandon()
            raise SessionError(f"cannot record in {folder}: {error.strerror}") from error
        if begin:
            self.begin(History())

    def begin(self, history: History) -> None:
        """Let messages follow; returns at once, whatever came before is written beside it.

        Parameters
        ----------
        history : History
            What was applied before; not changed any more.
        """
        before = partial(self._write_before, history)
        self._recorder = Recorder(self._bag, before=before, give_way=self._give_way)

    def _write_before(self, history: History) -> None:
        kind, bag = "application/json", self._bag
        if history.ticks:
            bag.add_attachment(HISTORY_FILE, kind, history.to_json().encode())
        if history.changes:
            bag.add_attachment(CHANGES_FILE, kind, history.changes_json().encode())
        bag.add_metadata(ABOUT, {**self._about, "start_tick": str(history.ticks)})

    @property
    def status(self) -> RecorderStatus:
        """Where the recording stands now."""
        return self._recorder.status

    def write(self, time: int, channel: Channel, data: bytes) -> None:
        """Record a serialised message of a log time, ns; never waits for the disk."""
        self._recorder.write(time, [(self._ids[channel], data)])

    def write_made(self, time: int, parts: Iterable[tuple[Encoders, Sequence[bytes]]]) -> None:
        """Record all messages of one log time, ns, with what made them."""
        entries: list[tuple[int, bytes]] = []
        for encoders, messages in parts:
            numbers = self._numbers.get(encoders)
            if numbers is None:
                numbers = [self._ids[channel] for channel, _ in encoders.each]
                self._numbers[encoders] = numbers
            entries.extend(zip(numbers, messages, strict=True))
        self._recorder.write(time, entries)

    def event(self, time: int, event: str, **details: object) -> None:
        """Record that something happened between ticks, as JSON on the events topic."""
        self.write(time, channels.EVENTS, channels.event_message(event, **details))

    def observe(
        self, observation: Observation, motion: Motion, tick_time: float | None = None
    ) -> None:
        """Record all outputs of a tick, the motion it applied, and how long it took, s."""
        time = nanoseconds(observation.time)
        parts = [(self._encoders, observation), (self._motion_encoders[motion.kind], motion)]
        if tick_time is not None:
            parts.append((TICK_TIME_ENCODERS, tick_time))
        self.write_made(time, [(each, each.together(time, subject)) for each, subject in parts])

    def close(self, timeout: float = 5.0) -> RecorderStatus:
        """Write what waits and finish the session; return how it ended."""
        return self._recorder.close(timeout)
