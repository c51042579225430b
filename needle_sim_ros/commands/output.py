# SPDX-License-Identifier: Apache-2.0
"""What subcommands write: JSON, tables, progress."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.plain import plain

if TYPE_CHECKING:
    from tqdm import tqdm

    from needle_sim_ros.scene import Scene
    from needle_sim_ros.simulator import Simulator

PROGRESS_DELAY = 2.0  # s; shorter work shows no bar


def check_writable(path: Path | None) -> None:
    """Make sure, before long work, that a file can be written; makes its folder.

    Raises
    ------
    NeedleSimError
        Saying which file and why not.
    """
    if path is None:
        return
    if path.is_dir():
        raise NeedleSimError(f"cannot write {path}: it is a folder")
    _check_parent(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not os.access(path, os.W_OK):
        raise NeedleSimError(f"cannot write {path}: no permission")


def check_new_folder(path: Path | None) -> None:
    """Make sure, before long work, that a folder can be made; makes nothing.

    Raises
    ------
    NeedleSimError
        When it exists or cannot be made, saying why.
    """
    if path is None:
        return
    if path.exists():
        raise NeedleSimError(f"{path} exists: a recording is never overwritten")
    _check_parent(path)


def _check_parent(path: Path) -> None:
    parent = next(folder for folder in path.absolute().parents if folder.exists())
    if not parent.is_dir():
        raise NeedleSimError(f"cannot write {path}: {parent} is not a folder")
    if not os.access(parent, os.W_OK):
        raise NeedleSimError(f"cannot write {path}: no permission in {parent}")


def check_picture(path: Path | None) -> None:
    """Make sure, before long work, that a picture can be written under this name."""
    from needle_sim_ros.view.files import picture_format

    if path is not None:
        picture_format(path)
        check_writable(path)


def write_json(path: Path | None, data: dict[str, Any]) -> None:
    """Write JSON that every reader takes: never NaN or Infinity."""
    if path is None:
        return
    text = json.dumps(plain(data), allow_nan=False)
    check_writable(path)
    path.write_text(text + "\n", encoding="utf-8")


def table(rows: Iterable[Sequence[str]], title: str = "", align: str = "<<") -> str:
    """Lay out rows of equal length in columns under a title.

    Parameters
    ----------
    rows : iterable of sequences of str
        The cells.
    title : str
        A line above.
    align : str
        ``<`` or ``>`` for each column.
    """
    rows = [list(row) for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [_strong(title)] if title else []
    for row in rows:
        cells = [f"{c:{a}{w}}" for c, a, w in zip(row, align, widths, strict=True)]
        lines.append(f"  {'  '.join(cells)}".rstrip())
    return "\n".join(lines)


def _strong(text: str) -> str:
    if sys.stdout.isatty() and "NO_COLOR" not in os.environ:
        return f"\033[1m{text}\033[0m"
    return text


def progress(total: float, description: str, unit: str = "tick") -> tqdm[Any]:
    """Return a progress bar: on a terminal only, and only once the work has taken two seconds."""
    from tqdm import tqdm

    return tqdm(
        total=total,
        desc=description,
        unit=unit,
        delay=PROGRESS_DELAY,
        disable=not sys.stderr.isatty(),
        leave=False,
        file=sys.stderr,
    )


@contextmanager
def _kept_alive(bar: tqdm[Any]) -> Iterator[None]:
    """Show a bar, with its clock, also while one long part is under way."""
    over = threading.Event()

    def beat() -> None:
        interval = PROGRESS_DELAY
        while not over.wait(interval):
            bar.refresh()
            interval = 0.5

    thread = threading.Thread(target=beat, name="progress", daemon=True)
    if not bar.disable:
        thread.start()
    try:
        yield
    finally:
        over.set()
        if thread.is_alive():
            thread.join()


def prepared(scene: Scene) -> Simulator:
    """Return the scene's simulator; its preparation shows progress if it takes long."""
    from needle_sim_ros.interaction import compiled_balance
    from needle_sim_ros.simulator import Simulator

    with progress(1, f"preparing {scene.name}", unit="part") as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        with _kept_alive(bar):
            simulator = Simulator(scene, advance)
    print(f"tissue: {simulator.preparation}", file=sys.stderr)
    if not compiled_balance.available():
        print("contact: numpy, nothing compiled (see doc/install.md)", file=sys.stderr)
    return simulator
