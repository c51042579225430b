# SPDX-License-Identifier: Apache-2.0
"""The inside of an MCAP chunk: unpacked within bounds, checked, and taken apart quickly."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import zstandard

from needle_sim_ros.errors import SessionError

LARGEST = 1 << 30
_PIECE = 1 << 20
_LARGEST_WINDOW = 1 << 26
_HEAD = struct.Struct("<QQQII")
_SIZE = struct.Struct("<Q")
_RECORD = struct.Struct("<BQ")
HEAD_ROOM = _HEAD.size + 64 + _SIZE.size


class DamageError(SessionError):
    """What was read is not what was written."""


@dataclass(frozen=True)
class ChunkHead:
    """What stands before the packed records of a chunk; times in ns, sizes in bytes."""

    first: int
    last: int
    size: int
    crc: int
    compression: str
    packed: int
    length: int

    @classmethod
    def read(cls, data: bytes) -> ChunkHead:
        """Read the head from the first bytes of a chunk record's content.

        Raises
        ------
        DamageError
            When it cannot be one.
        """
        try:
            first, last, size, crc, name = _HEAD.unpack_from(data)
            start = _HEAD.size + name
            compression = data[_HEAD.size : start].decode("ascii")
            (packed,) = _SIZE.unpack_from(data, start)
        except (struct.error, UnicodeDecodeError):
            raise DamageError("a chunk's head is damaged") from None
        if first > last or size > LARGEST:
            raise DamageError("a chunk's head is damaged")
        return cls(first, last, size, crc, compression, packed, start + _SIZE.size)

    def unpack(self, data: bytes) -> bytes:
        """Return the records that `data` holds, as many as there are; never more than `size`.

        Raises
        ------
        DamageError
            When they cannot be unpacked.
        """
        if self.compression == "":
            return data[: self.size]
        if self.compression == "zstd":
            return _unpack(_zstd(data), self.size)
        if self.compression == "lz4":
            return _unpack(_lz4(data), self.size)
        raise DamageError("a chunk is compressed in an unknown way")

    def unpack_whole(self, data: bytes) -> bytes:
        """Return the records, all of them and as they were written.

        Raises
        ------
        DamageError
            When size or checksum are not those noted.
        """
        records = self.unpack(data)
        if len(records) != self.size:
            raise DamageError("a chunk does not have its size")
        if self.crc and zlib.crc32(records) != self.crc:
            raise DamageError("a chunk's checksum does not hold")
        return records


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of each record in unpacked data, up to the last whole one."""
    offset, end = 0, len(data)
    unpack = _RECORD.unpack_from
    while offset + 9 <= end:
        opcode, length = unpack(data, offset)
        begin = offset + 9
        offset = begin + length
        if offset > end:
            return
        yield opcode, begin, offset


def _unpack(reader: Any, size: int) -> bytes:
    parts, left = [], size
    try:
        while left > 0:
            part = reader(min(left, _PIECE))
            if not part:
                break
            parts.append(part)
            left -= len(part)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        raise DamageError("a chunk cannot be unpacked") from None
    return b"".join(parts)


def _zstd(data: bytes) -> Any:
    return zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW).stream_reader(data).read


def _lz4(data: bytes) -> Any:
    try:
        unpacker = import_module("lz4.frame").LZ4FrameDecompressor()
    except ImportError:
        raise DamageError("a chunk is compressed with lz4, which is not installed") from None
    given = [data]

    def read(size: int) -> bytes:
        if unpacker.eof:
            return b""
        part: bytes = unpacker.decompress(given.pop() if given else b"", max_length=size)
        return part

    return read
