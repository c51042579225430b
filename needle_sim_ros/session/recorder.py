# SPDX-License-Identifier: Apache-2.0
"""Recording that never blocks who records: a bounded queue and a writer thread."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from needle_sim_ros.session.bag import Bag
from needle_sim_ros.session.mcap_file import Entry

_CAPACITY = 64 << 20
_CHUNK = 1 << 18
_INTERVAL = 0.2
_NOTHING: Counter[int] = Counter()
_OVERHEAD = 120  # of a queued message beside its bytes


@dataclass(frozen=True)
class RecorderStatus:
    """Where a recording stands.

    Parameters
    ----------
    written : int
        Messages in the file.
    size : int
        Bytes in the file.
    queued : int
        Messages waiting for the writer.
    lost : int
        Messages that could not be written.
    error : str
        The last reason for a loss; empty when there was none.
    """

    written: int = 0
    size: int = 0
    queued: int = 0
    lost: int = 0
    error: str = ""


class Recorder:
    """Writes messages to a bag from a thread of its own.

    A chunk is closed and handed to the operating system at least every `interval`, so
    that a killed process loses no more than that.

    Parameters
    ----------
    bag : Bag
        Written and, in the end, closed here.
    capacity : int
        Bytes that may wait; what comes beyond is lost and counted.
    interval : float
        Wall time between chunks, s.
    before : callable
        Writes to the bag what comes before all messages, in the thread.
    give_way : callable
        Called by the thread every few messages; may wait, so that something more urgent has
        the interpreter to itself.
    """

    def __init__(
        self,
        bag: Bag,
        capacity: int = _CAPACITY,
        interval: float = _INTERVAL,
        before: Callable[[], object] = lambda: None,
        give_way: Callable[[], object] = lambda: None,
    ) -> None:
        self._bag = bag
        self._capacity = capacity
        self._interval = interval
        self._lock = threading.Lock()
        # Log time, messages, and what was lost before them: numbered by the writer thread.
        self._queue: list[tuple[int, Sequence[tuple[int, bytes]], Counter[int]]] = []
        self._missing: Counter[int] = Counter()
        self._queued = 0
        self._queued_bytes = 0
        self._sequence: dict[int, int] = {}
        self._written = self._in_hand = self._lost = self._size = 0
        self._error = ""
        self._gone = False
        self._closing = False
        self._wake = threading.Event()
        self._before = before
        self._give_way = give_way
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def status(self) -> RecorderStatus:
        """Where the recording stands now."""
        with self._lock:
            queued = self._queued + self._in_hand
            return RecorderStatus(self._written, self._size, queued, self._lost, self._error)

    def write(self, time: int, messages: Sequence[tuple[int, bytes]]) -> None:
        """Queue messages of one log time, all or none; never waits for the disk.

        Parameters
        ----------
        time : int
            Log time, ns.
        messages : sequence of (int, bytes)
            Channel ids and serialised messages; not changed any more.
        """
        size = _OVERHEAD * len(messages) + sum([len(data) for _, data in messages])
        with self._lock:
            if self._closing or self._queued_bytes + size > self._capacity:
                self._lost += len(messages)
                self._error = "recording ended" if self._closing else "the disk is too slow"
                self._missing.update(channel for channel, _ in messages)
                return
            missing = _NOTHING
            if self._missing:
                missing, self._missing = self._missing, Counter()
            self._queue.append((time, messages, missing))
            self._queued += len(messages)
            self._queued_bytes += size
            full = self._queued_bytes > _CHUNK
        if full:
            self._wake.set()

    def close(self, timeout: float = 5.0) -> RecorderStatus:
        """Write what waits, finish the bag, and return how it ended.

        Parameters
        ----------
        timeout : float
            How long to wait for the disk, s; a disk that takes longer leaves a file
            without a summary.
        """
        with self._lock:
            self._closing = True
        self._wake.set()
        self._thread.join(timeout)
        if self._thread.is_alive():
            with self._lock:
                self._error = f"the disk did not answer within {timeout:g} s"
        return self.status

    def _run(self) -> None:
        try:
            self._before()
        except Exception as error:
            self._note(0, 0, _reason(error))
        closing = False
        while not closing:
            self._wake.wait(self._interval)
            self._wake.clear()
            with self._lock:
                closing = self._closing
                batch, self._queue = self._queue, []
                self._in_hand, self._queued, self._queued_bytes = self._queued, 0, 0
            for part in _parts(self._numbered(batch)):
                for piece in self._bag.pieces(part):
                    self._write(piece)
        self._check_removed()
        try:
            made_room = self._bag.close()
        except Exception as error:
            if not self._gone:
                self._note(0, 0, f"recording not finished: {_reason(error)}")
        else:
            if made_room:
                self._note(-made_room, made_room, "no room for the index")

    def _numbered(
        self, batch: Iterable[tuple[int, Sequence[tuple[int, bytes]], Counter[int]]]
    ) -> list[Entry]:
        """Return entries with sequence numbers, which leave out what was lost."""
        entries, numbers = [], self._sequence
        for time, messages, missing in batch:
            self._give_way()
            for channel, count in missing.items():
                numbers[channel] = (numbers.get(channel, 0) + count) & 0xFFFFFFFF
            for channel, data in messages:
                number = numbers.get(channel, 0)
                numbers[channel] = (number + 1) & 0xFFFFFFFF
                entries.append((channel, number, time, data))
        return entries

    def _write(self, part: Sequence[Entry]) -> None:
        try:
            self._bag.write(part, self._give_way)
        except Exception as error:  # whatever it is, it is counted and the simulation goes on
            self._note(0, len(part), _reason(error))
        else:
            self._note(len(part), 0, "")
        with self._lock:
            self._in_hand -= len(part)
        self._check_removed()

    def _check_removed(self) -> None:
        self._gone = self._gone or self._bag.file.removed
        if self._gone:
            with self._lock:
                written, self._written = self._written, 0
            self._note(0, written, f"{self._bag.folder} was removed")

    def _note(self, written: int, lost: int, error: str) -> None:
        with self._lock:
            self._written += written
            self._lost += lost
            self._size = self._bag.size
            self._error = error or self._error


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _parts(batch: list[Entry]) -> Iterable[list[Entry]]:
    start = size = 0
    for k, entry in enumerate(batch):
        size += len(entry[3])
        if size > _CHUNK:
            yield batch[start : k + 1]
            start, size = k + 1, 0
    if start < len(batch):
        yield batch[start:]
