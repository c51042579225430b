# SPDX-License-Identifier: Apache-2.0
"""Where the time goes, by function of this package: a sampling profile.

A signal interrupts the work every few milliseconds of processor time and notes which function
of the package it is in, for itself or for the library it called. Unlike a tracing profiler
that costs the short functions no more than the long ones.
"""

from __future__ import annotations

import signal
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

_PACKAGE = Path(__file__).resolve().parents[1]
_HERE = str(Path(__file__).resolve().parent)


@contextmanager
def sampled(interval: float = 1e-3) -> Iterator[Counter[str]]:
    """Count, while inside, how often each ``file:function`` of the package was at work.

    Parameters
    ----------
    interval : float
        Processor time between samples, s; the kernel may make it longer.

    Yields
    ------
    Counter
        Empty outside the main thread, where Python delivers no signals.
    """
    counts: Counter[str] = Counter()

    def note(signum: int, frame: FrameType | None) -> None:
        label = _label(frame)
        if label is not None:
            counts[label] += 1

    if threading.current_thread() is not threading.main_thread():
        yield counts
        return
    before = signal.signal(signal.SIGPROF, note)
    signal.setitimer(signal.ITIMER_PROF, interval, interval)
    try:
        yield counts
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _label(frame: FrameType | None) -> str | None:
    """Return the innermost function of the package, None in the benchmarks themselves."""
    while frame is not None:
        file = frame.f_code.co_filename
        if file.startswith(_HERE):
            return None
        if file.startswith(str(_PACKAGE)):
            where = Path(file).relative_to(_PACKAGE).as_posix()
            return f"{where}:{frame.f_code.co_name}"
        frame = frame.f_back
    return None
