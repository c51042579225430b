# SPDX-License-Identifier: Apache-2.0
"""Where the plant's messages go: to the topics that somebody hears, and into the session."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.bag import FolderTakenError, Split, new_folder
from needle_sim_ros.session.channels import Channel
from needle_sim_ros.session.encoding import Encoders
from needle_sim_ros.session.recorder import RecorderStatus
from needle_sim_ros.session.writer import SessionWriter

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene
    from needle_sim_ros.session.history import History

_NAMES = 100  # tries for a folder's name that no other node takes at the same time


@dataclass(eq=False, slots=True)
class Sink:
    """Where a topic's bytes go, and whether anybody wants them now."""

    publish: Callable[[bytes], object]
    wanted: bool = False


_NOBODY = Sink(lambda data: None)


@dataclass(frozen=True)
class Naming:
    """Frame ids, resolved topic names, and what else a session says about itself."""

    tissue_frame: str
    base_frame: str
    topics: Mapping[Channel, str] = field(default_factory=dict)
    settings: Callable[[], Mapping[str, str]] = dict


class Outlet:
    """Publishes what is wanted, records everything; nothing is made in vain.

    Parameters
    ----------
    naming : Naming
        For the sessions.
    sinks : mapping of Channel to Sink
        Where messages are published; a topic without a sink is only recorded.
    give_way : callable
        As the session's.
    """

    def __init__(
        self,
        naming: Naming,
        sinks: Mapping[Channel, Sink],
        give_way: Callable[[], object] = lambda: None,
    ) -> None:
        self._naming = naming
        self._sinks = sinks
        self._in_order: dict[Encoders, list[Sink]] = {}  # sinks of the topics of each
        self._give_way = give_way
        self._session: SessionWriter | None = None
        self._writing = threading.Lock()  # a command is written whole, or the session is over
        self._ended = RecorderStatus()
        self.epoch = 0  # what resets have to add to stamps, so that log time never goes back

    @property
    def folder(self) -> Path | None:
        """Folder of the session being recorded."""
        session = self._session
        return None if session is None else session.folder

    @property
    def status(self) -> RecorderStatus:
        """Where the recording stands, or how the last one ended."""
        session = self._session
        return self._ended if session is None else session.status

    def emit(self, stamp: int, *parts: tuple[Any, Encoders]) -> None:
        """Publish and record messages of one simulated time, ns, as far as they are wanted.

        Each part is a subject and what makes its messages.
        """
        session = self._session
        made: list[tuple[Encoders, Sequence[bytes]]] = []
        for subject, encoders in parts:
            sinks = self._in_order.get(encoders)
            if sinks is None:
                sinks = [self._sinks.get(channel, _NOBODY) for channel, _ in encoders.each]
                self._in_order[encoders] = sinks
            if session is None:
                for sink, (_, encode) in zip(sinks, encoders.each, strict=True):
                    if sink.wanted:
                        sink.publish(encode(stamp, subject))
                continue
            messages = encoders.together(stamp, subject)
            made.append((encoders, messages))
            for sink, data in zip(sinks, messages, strict=True):
                if sink.wanted:
                    sink.publish(data)
        if session is not None:
            session.write_made(self.epoch + stamp, made)

    def record(self, stamp: int, channel: Channel, data: bytes) -> None:
        """Record a message, if a session is being recorded."""
        with self._writing:
            session = self._session
            if session is not None:
                session.write(self.epoch + stamp, channel, data)

    def publish(self, channel: Channel, encode: Callable[[int], bytes], stamp: int) -> None:
        """Publish on a topic, if it has a sink, and do not record."""
        sink = self._sinks.get(channel)
        if sink is not None:
            sink.publish(encode(stamp))

    def prepare(self, parent: Path, scene: Scene, period: float, split: Split) -> SessionWriter:
        """Return a session in a new folder of `parent`, for :meth:`attach`; takes its time.

        Raises
        ------
        SessionError
            When one is being recorded already, or none can be.
        """
        if self._session is not None:
            raise SessionError(f"already recording in {self._session.folder}")
        naming = self._naming
        for attempt in range(_NAMES):
            folder = new_folder(parent, scene.name)
            try:
                return SessionWriter(
                    folder,
                    scene,
                    period,
                    names=naming.topics,
                    tissue_frame=naming.tissue_frame,
                    base_frame=naming.base_frame,
                    settings=naming.settings(),
                    split=split,
                    begin=False,
                    give_way=self._give_way,
                )
            except FolderTakenError:  # another node took the name just now
                if attempt + 1 == _NAMES:
                    raise
        raise AssertionError

    def attach(self, session: SessionWriter, history: History) -> None:
        """Record into a session from now on, after a history that is over."""
        session.begin(history)
        self._session = session
        self.epoch = 0  # resets before it are no business of this session's

    def detach(self) -> SessionWriter:
        """Return the session being recorded, into which nothing goes any more.

        Raises
        ------
        SessionError
            When none is being recorded.
        """
        with self._writing:
            session, self._session = self._session, None
        if session is None:
            raise SessionError("not recording")
        return session

    def finish(self, session: SessionWriter, timeout: float) -> RecorderStatus:
        """Finish a detached session; return how it ended. Waits for the disk."""
        self._ended = session.close(timeout)
        return self._ended
