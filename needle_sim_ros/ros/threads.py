# SPDX-License-Identifier: Apache-2.0
"""The threads of this process, those that Python did not start included."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

_THREADS = Path("/proc/self/task")


def for_each_thread(do: Callable[[int], object]) -> None:
    """Call a function with every thread's native number; one that has just ended is passed over."""
    for task in _THREADS.iterdir():
        with contextlib.suppress(ProcessLookupError):
            do(int(task.name))
