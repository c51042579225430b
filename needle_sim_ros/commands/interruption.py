# SPDX-License-Identifier: Apache-2.0
"""Signals that end work at points where it can be ended."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interruption:
    """Keeps Ctrl-C, SIGTERM and SIGHUP until :meth:`check`, while a ``with`` block runs.

    A KeyboardInterrupt raised inside rclpy's compiled parts comes out as another
    exception or not at all. The second signal does not wait.
    """

    def __init__(self) -> None:
        self._came = False

    def __enter__(self) -> Interruption:
        self._before = {number: signal.signal(number, self._note) for number in _SIGNALS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if error is None:
            self.check()

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self._came:
            raise KeyboardInterrupt

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._came:
            raise KeyboardInterrupt
        self._came = True
