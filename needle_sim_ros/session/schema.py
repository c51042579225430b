# SPDX-License-Identifier: Apache-2.0
"""Message definitions as MCAP wants them, from the installed ROS packages.

The `.msg` texts and the type hashes lie in `share/<package>/msg` of every prefix of the
ament index: `/opt/ros/jazzy` of a ROS installation, or the Python environment that
holds the ROS wheels.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from needle_sim_ros.errors import SessionError

_SEPARATOR = "=" * 80
_PRIMITIVES = frozenset(
    (
        *("bool", "byte", "char", "float32", "float64", "string", "wstring"),
        *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    )
)
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(<=\d+)?(\[[^\]]*\])?\s+[A-Za-z]\w*")


@dataclass(frozen=True)
class MessageSchema:
    """A message type: full name `package/msg/Type`, `ros2msg` text, RIHS01 hash."""

    name: str
    text: str
    type_hash: str


@cache
def message_schema(name: str) -> MessageSchema:
    """Return the schema of a message type.

    Parameters
    ----------
    name : str
        Full name, e.g. ``geometry_msgs/msg/PoseStamped``.

    Raises
    ------
    SessionError
        When the type, or one it contains, is not installed.
    """
    texts: dict[str, str] = {}
    _collect(name, texts)
    main, *others = texts
    parts = [texts[main]]
    for other in others:
        package, _, kind = other.split("/")
        parts.append(f"{_SEPARATOR}\nMSG: {package}/{kind}\n{texts[other]}")
    return MessageSchema(name, "\n".join(parts), _type_hash(name))


def _prefixes() -> Iterator[Path]:
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix)
    yield Path(sys.prefix)
    distro = os.environ.get("ROS_DISTRO", "jazzy")
    yield Path("/opt/ros") / distro


def _file(name: str, suffix: str) -> Path:
    package, folder, kind = name.split("/")
    for prefix in _prefixes():
        path = prefix / "share" / package / folder / (kind + suffix)
        if path.is_file():
            return path
    searched = ", ".join(str(prefix) for prefix in dict.fromkeys(_prefixes()))
    raise SessionError(
        f"message definition {name}{suffix} not found in {searched}: source a ROS 2 workspace "
        "or install the ROS wheels (make env)"
    )


def _collect(name: str, texts: dict[str, str]) -> None:
    if name in texts:
        return
    texts[name] = _file(name, ".msg").read_text(encoding="utf-8").rstrip() + "\n"
    package = name.split("/")[0]
    for line in texts[name].splitlines():
        match = _FIELD.match(line.split("#")[0])
        if match is None or match[1] in _PRIMITIVES:
            continue
        kind = match[1]
        full = f"{package}/{kind}" if "/" not in kind else kind
        owner, _, base = full.rpartition("/")
        _collect(f"{owner.split('/')[0]}/msg/{base}", texts)


def _type_hash(name: str) -> str:
    data = json.loads(_file(name, ".json").read_text(encoding="utf-8"))
    for entry in data["type_hashes"]:
        if entry["type_name"] == name:
            return str(entry["hash_string"])
    raise SessionError(f"no type hash of {name} in {_file(name, '.json')}")
