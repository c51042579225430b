# SPDX-License-Identifier: Apache-2.0
"""What the node last said of itself in a recording: its rate, its commands, its recorder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mcap_ros2.decoder import DecoderFactory

from needle_sim_ros.session import channels
from needle_sim_ros.session.content import Content

_LEVELS = {0: "ok", 1: "warning", 2: "error", 3: "stale"}


@dataclass(frozen=True)
class Part:
    """One status of `/diagnostics`.

    Parameters
    ----------
    name : str
        Of the part, without the node's.
    level : str
        ``ok``, ``warning``, ``error`` or ``stale``.
    message : str
        What it says.
    values : mapping of str to str
        Its figures.
    """

    name: str
    level: str
    message: str
    values: Mapping[str, str]


def last_diagnostics(content: Content, about: Mapping[str, str]) -> list[Part]:
    """Return the last diagnostics that can be read; none where none were recorded."""
    channel = channels.DIAGNOSTICS
    topic = about.get(f"topic.{channel.role}", channel.name)
    messages = content.of_topic(topic, channel.type)
    schema = next((s for s in content.schemas.values() if s.name == channel.type), None)
    if not messages or schema is None:
        return []
    decode = DecoderFactory().decoder_for("cdr", schema)
    if decode is None:
        return []
    return [
        Part(
            status.name.rpartition(": ")[2],
            _LEVELS.get(_number(status.level), "stale"),
            status.message,
            {pair.key: pair.value for pair in status.values},
        )
        for status in decode(messages[-1][-1]).status
    ]


def _number(level: int | bytes) -> int:
    """Return a `byte` field as a number: decoders give either."""
    return level[0] if isinstance(level, bytes) else level
