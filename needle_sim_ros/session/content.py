# SPDX-License-Identifier: Apache-2.0
"""Everything in an MCAP file, messages as bytes by topic, up to where it is damaged."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from operator import itemgetter
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.mcap_walk import CUT_OFF, Damage, Source, walk

Message = tuple[int, int, bytes]  # sequence, log time in ns, data
MESSAGE_HEAD = struct.Struct("<HIQQ")
_RECORD = struct.Struct("<BQ")
_RECORD_AND_HEAD = struct.Struct("<BQHIQQ")
UNREADABLE = (McapError, struct.error, UnicodeDecodeError)


@dataclass(frozen=True)
class Content:
    """What a file holds.

    Parameters
    ----------
    damage : Damage or None
        Where reading ended and why, if not at the end of a whole file.
    attachments : dict of str to bytes
        By name.
    metadata : dict of str to dict
        By name.
    schemas, channels : dict
        By id.
    messages : dict of int to list of (int, int, bytes)
        Sequence number, log time in ns, and data of every message, by channel id.
    """

    damage: Damage | None
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    messages: dict[int, list[Message]]

    def of_topic(self, topic: str, kind: str) -> list[Message]:
        """Return the messages of a topic that have this type, by log time."""
        found = [
            message
            for number, channel in self.channels.items()
            if channel.topic == topic
            and channel.schema_id in self.schemas
            and self.schemas[channel.schema_id].name == kind
            for message in self.messages.get(number, [])
        ]
        return sorted(found, key=itemgetter(1))


@dataclass
class Definitions:
    """Schemas and channels met so far; the first of an id counts."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, opcode: int, content: bytes) -> None:
        """Take a schema or a channel; one that cannot be read is left out."""
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                self.channels.setdefault(channel.id, channel)
        except UNREADABLE:
            return


def read_content(path: Path) -> Content:
    """Read a file up to its end or its first damage.

    Raises
    ------
    SessionError
        When it cannot be opened or is no MCAP file.
    """
    damage: Damage | None = None
    attachments: dict[str, bytes] = {}
    metadata: dict[str, dict[str, str]] = {}
    definitions = Definitions()
    messages: defaultdict[int, list[Message]] = defaultdict(list)
    with Source(path) as source:
        for piece in walk(source):
            if isinstance(piece, Damage):
                if piece.offset == 0 and piece.reason != CUT_OFF:
                    raise SessionError(f"{path}: not an MCAP file")
                damage = piece
                break
            if piece.opcode == Opcode.ATTACHMENT:
                attachment = read_attachment(piece.content)
                attachments[attachment.name] = attachment.data
            elif piece.opcode == Opcode.METADATA:
                record = read_metadata(piece.content)
                metadata[record.name] = dict(record.metadata)
            if piece.opcode == Opcode.CHUNK:
                _unpacked(piece.content, messages, definitions)
            elif piece.opcode == Opcode.MESSAGE and len(piece.content) >= MESSAGE_HEAD.size:
                channel, sequence, time, _ = MESSAGE_HEAD.unpack_from(piece.content)
                messages[channel].append((sequence, time, piece.content[MESSAGE_HEAD.size :]))
            elif piece.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                definitions.add(piece.opcode, piece.content)
    return Content(
        damage,
        attachments,
        metadata,
        definitions.schemas,
        definitions.channels,
        dict(messages),
    )


def read_contents(paths: Sequence[Path]) -> Content:
    """Read the files of a bag as one; of attachments and metadata the first of a name counts.

    Raises
    ------
    SessionError
        When one cannot be opened or is no MCAP file.
    """
    contents = [read_content(path) for path in paths]
    if len(contents) == 1:
        return contents[0]
    whole = Content(
        next((c.damage for c in contents if c.damage is not None), None), {}, {}, {}, {}, {}
    )
    numbers: dict[tuple[str, str, str, bytes], int] = {}
    for content in contents:
        for name, data in content.attachments.items():
            whole.attachments.setdefault(name, data)
        for name, values in content.metadata.items():
            whole.metadata.setdefault(name, values)
        for number, channel in content.channels.items():
            schema = content.schemas.get(channel.schema_id)
            if schema is None:
                continue
            key = (channel.topic, channel.message_encoding, schema.name, schema.data)
            if key not in numbers:
                numbers[key] = len(numbers) + 1
                whole.schemas[numbers[key]] = replace(schema, id=numbers[key])
                whole.channels[numbers[key]] = replace(
                    channel, id=numbers[key], schema_id=numbers[key]
                )
            messages = content.messages.get(number, [])
            whole.messages.setdefault(numbers[key], []).extend(messages)
    return whole


def read_attachment(content: bytes) -> Attachment:
    """Return an attachment from the content of its record."""
    return Attachment.read(ReadDataStream(BytesIO(content)))


def read_metadata(content: bytes) -> Metadata:
    """Return a metadata record from its content."""
    return Metadata.read(ReadDataStream(BytesIO(content)))


def _unpacked(
    data: bytes, messages: defaultdict[int, list[Message]], definitions: Definitions
) -> None:
    """Take the messages, schemas and channels of a chunk, up to its last whole record.

    A session has ten messages a tick: record and message head are read in one go.
    """
    offset, end = 0, len(data)
    of_record, of_both = _RECORD.unpack_from, _RECORD_AND_HEAD.unpack_from
    kind, least = Opcode.MESSAGE, MESSAGE_HEAD.size
    while offset + _RECORD.size <= end:
        if offset + _RECORD_AND_HEAD.size <= end:
            opcode, length, channel, sequence, time, _ = of_both(data, offset)
        else:
            opcode, length = of_record(data, offset)
        begin = offset + _RECORD.size
        offset = begin + length
        if offset > end:
            return
        if opcode == kind and length >= least:
            messages[channel].append((sequence, time, data[begin + least : offset]))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.add(opcode, data[begin:offset])
