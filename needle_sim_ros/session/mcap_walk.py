# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file, one after another, whole or damaged.

Checksums of chunks and attachments are always checked. After a damaged place the walk
goes on at the next record that proves itself: by its checksum, or because nothing of it
is left over when it is read.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from mcap.opcode import Opcode

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.mcap_chunk import HEAD_ROOM, ChunkHead, DamageError
from needle_sim_ros.session.mcap_records import MAGIC

CUT_OFF, NOT_FINISHED = "cut off", "the file was not finished"
_PRIVATE = 0x80
_WINDOW = 1 << 20
_OVERLAP = 9
# Attachments, chunks and metadata: the records by which the walk finds its way again.
_CANDIDATE = re.compile(rb"[\x06\x09\x0c].{5}\x00\x00\x00", re.DOTALL)
_RECORD = struct.Struct("<BQ")
_LENGTH = struct.Struct("<I")


@dataclass(frozen=True)
class Piece:
    """A record: place, opcode, content; of a chunk the unpacked records.

    `cut` says that the file ends within it.
    """

    offset: int
    end: int
    opcode: int
    content: bytes
    cut: bool = False


@dataclass(frozen=True)
class Damage:
    """Bytes of a file that cannot be read, and why."""

    offset: int
    length: int
    reason: str


class Source:
    """A file that is only read, piece by piece.

    Raises
    ------
    SessionError
        When it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("rb", buffering=0)
            self.size = os.fstat(self._file.fileno()).st_size
        except OSError as error:
            raise SessionError(f"{path}: {error.strerror}") from None

    def read(self, offset: int, length: int) -> bytes:
        """Return bytes of the file, fewer where it ends."""
        parts = []
        while length > 0:
            part = os.pread(self._file.fileno(), length, offset)
            if not part:
                break
            parts.append(part)
            offset, length = offset + len(part), length - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def __enter__(self) -> Source:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()


def walk(source: Source) -> Iterator[Piece | Damage]:
    """Yield records and, between them, what is damaged; the last is a footer if it is whole."""
    head = source.read(0, len(MAGIC))
    if head != MAGIC:
        cut = MAGIC.startswith(head)
        yield Damage(0, len(head), CUT_OFF if cut else "it does not begin as an MCAP file")
    position = len(MAGIC)
    while position < source.size:
        try:
            piece = _record(source, position)
        except DamageError as error:
            after = _next(source, position)
            end = source.size if after is None else after
            if after is None:
                yield from _cut_chunk(source, position)
            yield Damage(position, end - position, str(error))
            position = end
            continue
        yield piece
        position = piece.end
        if piece.opcode == Opcode.FOOTER:
            position += len(MAGIC)
            if position != source.size:
                yield Damage(position, source.size - position, "more after the end")
            return
    yield Damage(source.size, 0, NOT_FINISHED)


def _frame(head: bytes) -> tuple[int, int]:
    """Return opcode and length of a record that can be one, by its first bytes."""
    if len(head) < _RECORD.size:
        raise DamageError(CUT_OFF)
    opcode, length = _RECORD.unpack_from(head)
    if not (1 <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE):
        raise DamageError("no record begins where one should")
    return opcode, length


def _record(source: Source, position: int) -> Piece:
    begin = position + _RECORD.size
    head = source.read(position, _RECORD.size + HEAD_ROOM)
    alike = _like_chunk(source, position, head)
    if alike is not None:
        return alike
    opcode, length = _frame(head)
    if opcode == Opcode.CHUNK:
        return _chunk(source, position, length)
    if begin + length > source.size:
        raise DamageError(CUT_OFF)
    content = source.read(begin, length)
    if opcode == Opcode.ATTACHMENT:
        if not _attachment_holds(content):
            raise DamageError("an attachment's checksum does not hold")
    elif opcode == Opcode.METADATA:
        if not _metadata_holds(content):
            raise DamageError("a metadata record is damaged")
    elif opcode == Opcode.MESSAGE_INDEX:
        # with a wrong length it would swallow the chunks that follow
        if length < 6 or 6 + _LENGTH.unpack_from(content, 2)[0] != length:
            raise DamageError("a message index is damaged")
    elif opcode == Opcode.FOOTER:
        if length != 20 or source.read(begin + length, len(MAGIC)) != MAGIC:
            raise DamageError("the file's end is damaged")
    elif opcode >= _PRIVATE and not _stands(source, begin + length):
        raise DamageError("no record begins where one should")
    return Piece(position, begin + length, opcode, content)


def _like_chunk(source: Source, position: int, head: bytes) -> Piece | None:
    """Return what is a chunk by all but its opcode, in which a bit may be wrong."""
    if len(head) < _RECORD.size or head[0] == Opcode.CHUNK:
        return None
    _, length = _RECORD.unpack_from(head)
    try:
        inside = ChunkHead.read(head[_RECORD.size :])
        if not inside.crc or inside.length + inside.packed != length:
            return None
        return _chunk(source, position, length)
    except DamageError:
        return None


def _chunk(source: Source, position: int, length: int) -> Piece:
    """Read a chunk whose length stands in it twice: one of them may be damaged."""
    begin = position + _RECORD.size
    head = ChunkHead.read(source.read(begin, HEAD_ROOM))
    reason = DamageError(CUT_OFF)
    for packed in dict.fromkeys((head.packed, length - head.length)):
        end = begin + head.length + packed
        if packed < 0 or end > source.size:
            continue
        try:
            content = head.unpack_whole(source.read(begin + head.length, packed))
        except DamageError as error:
            reason = error
        else:
            return Piece(position, end, Opcode.CHUNK, content)
    raise reason


def _cut_chunk(source: Source, position: int) -> Iterator[Piece]:
    """Yield what is there of a chunk within which the file ends."""
    begin = position + _RECORD.size
    try:
        opcode, length = _frame(source.read(position, _RECORD.size))
        if opcode != Opcode.CHUNK or begin + length <= source.size:
            return
        head = ChunkHead.read(source.read(begin, HEAD_ROOM))
        if head.length + head.packed != length:
            return
        content = head.unpack(source.read(begin + head.length, source.size))
    except DamageError:
        return
    if content:
        yield Piece(position, source.size, Opcode.CHUNK, content, cut=True)


def _next(source: Source, position: int) -> int | None:
    """Return where the walk can go on after a damaged record.

    At its end, unless a record within proves itself: then it is the length that is damaged.
    """
    try:
        _, length = _frame(source.read(position, _RECORD.size))
        end = position + _RECORD.size + length
        if end < source.size and _stands(source, end):
            within = _search(source, position + 1, end)
            return end if within is None else within
    except DamageError:
        pass
    return _search(source, position + 1, source.size)


def _stands(source: Source, position: int) -> bool:
    """Return whether a record can begin here."""
    try:
        _, length = _frame(source.read(position, _RECORD.size))
    except DamageError:
        return False
    return position + _RECORD.size + length <= source.size


def _search(source: Source, position: int, end: int) -> int | None:
    """Return the first place before an end at which a record proves itself."""
    while position < end:
        window = source.read(position, min(_WINDOW, end - position) + _OVERLAP)
        match = _CANDIDATE.search(window)
        while match is not None and position + match.start() < end:
            try:
                _record(source, position + match.start())
            except DamageError:
                match = _CANDIDATE.search(window, match.start() + 1)
            else:
                return position + match.start()
        position += _WINDOW
    return None


def _attachment_holds(content: bytes) -> bool:
    if len(content) < 4:
        return False
    (crc,) = _LENGTH.unpack_from(content, len(content) - 4)
    return crc in (0, zlib.crc32(content[:-4]))


def _metadata_holds(content: bytes) -> bool:
    """Return whether a name and a map of strings fill the record."""
    try:
        (name,) = _LENGTH.unpack_from(content)
        (left,) = _LENGTH.unpack_from(content, 4 + name)
        content[4 : 4 + name].decode()
        position, end = 8 + name, 8 + name + left
        if end != len(content):
            return False
        while position < end:
            (size,) = _LENGTH.unpack_from(content, position)
            content[position + 4 : position + 4 + size].decode()
            position += 4 + size
    except (struct.error, UnicodeDecodeError):
        return False
    return position == end and bool(name)
