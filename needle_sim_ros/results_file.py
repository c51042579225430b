# SPDX-License-Identifier: Apache-2.0
"""Results that stream to a file of JSON lines, so that interrupted work goes on where it was."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.plain import plain

Entry = dict[str, Any]


class ResultsFile:
    """A header line, which says what the results are of, and one result a line.

    Parameters
    ----------
    path : Path
        Begun when it is not there; a last line that was not finished is cut off.
    kind : str
        What the file is, ``study`` for instance.
    version : int
        Of its lines.
    of : str
        What the results hang on: those of a file of anything else are not taken.
    subject : str
        The same in words, for the message.

    Raises
    ------
    NeedleSimError
        When the file is of another kind or version, or of something else; it is left as it is.

    Attributes
    ----------
    entries : list of dict
        What the file holds.
    """

    def __init__(self, path: Path, kind: str, version: int, of: str, subject: str) -> None:
        self.path, self.entries = path, list[Entry]()
        if not path.exists() or path.stat().st_size == 0:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._write({_key(kind): version, "of": of})
            return
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        lines = data[:whole].decode("utf-8", errors="replace").splitlines()
        first = _first(path, lines[0] if lines else "", kind, version)
        if first.get("of") != of:
            raise NeedleSimError(f"{path}: a {kind} of another {subject}; name a new file")
        for index, line in enumerate(lines[1:], start=2):
            try:
                self.entries.append(dict(json.loads(line)))
            except (ValueError, TypeError):
                raise NeedleSimError(f"{path}: line {index} is not a result of a {kind}") from None
        if whole < len(data):
            os.truncate(path, whole)

    def append(self, entry: Entry) -> None:
        """Add a result."""
        self._write(entry)
        self.entries.append(entry)

    def _write(self, line: Entry) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(plain(line), allow_nan=False) + "\n")


def check_version(path: Path, kind: str, version: int) -> None:
    """Refuse, before any work, a file of another kind or version."""
    if path.exists() and path.stat().st_size > 0:
        with path.open(encoding="utf-8", errors="replace") as file:
            _first(path, file.readline(), kind, version)


def _key(kind: str) -> str:
    return f"needle_sim_{kind}"


def _first(path: Path, line: str, kind: str, version: int) -> Entry:
    try:
        first = dict(json.loads(line))
        found = first[_key(kind)]
    except (ValueError, KeyError, TypeError):
        raise NeedleSimError(f"{path}: not a {kind} of needle_sim") from None
    if found != version:
        raise NeedleSimError(
            f"{path}: a {kind} of version {found!r}; this program reads version {version}"
        )
    return first
