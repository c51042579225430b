# SPDX-License-Identifier: Apache-2.0
"""Bytes of MCAP records, and of how a file ends."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord, SummaryOffset

MAGIC = b"\x89MCAP0\r\n"


def record_bytes(record: McapRecord) -> bytes:
    """Return a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()
    return data


def message_index(channel: int, records: Sequence[tuple[int, int]]) -> bytes:
    """Return the index of a channel's messages in a chunk: log times and offsets."""
    flat = [number for record in records for number in record]
    body = struct.pack(f"<HI{len(flat)}Q", channel, 8 * len(flat), *flat)
    return struct.pack("<BQ", Opcode.MESSAGE_INDEX, len(body)) + body


def ending(start: int, groups: Iterable[tuple[Opcode, Iterable[bytes]]]) -> bytes:
    """Return what follows the last record: end of data, summary, footer.

    Parameters
    ----------
    start : int
        Where in the file this goes.
    groups : iterable of (Opcode, iterable of bytes)
        The records of the summary, by kind.
    """
    data_end = record_bytes(DataEnd(0))
    start += len(data_end)
    summary, offsets = b"", b""
    for opcode, records in groups:
        group = b"".join(records)
        if group:
            offsets += record_bytes(SummaryOffset(opcode, start + len(summary), len(group)))
        summary += group
    offset_start = start + len(summary)
    summary += offsets
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
    footer = Footer(start, offset_start, zlib.crc32(summary + head))
    return data_end + summary + record_bytes(footer) + MAGIC
