# SPDX-License-Identifier: Apache-2.0
"""One MCAP file whose end is always at a whole chunk.

The writer of the `mcap` package cannot go on after a failed write: its indexes then name
data that is not there. Here a chunk is written in one go, and the file is cut back to
its last whole record when the disk refuses; what is in the file is always readable. If
there is no room for the summary at the end, the last chunks make room.
"""

from __future__ import annotations

import errno
import io
import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.mcap_records import MAGIC, ending, message_index, record_bytes

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_MESSAGE = struct.Struct("<BQHIQQ")
_TIMES = struct.Struct("<QQ")
_MESSAGE_FIXED, _INDEX_FIXED = 22, 6
_FEW = 8  # messages that are packed without a pause

# channel id, sequence, log time in ns, serialised message
Entry = tuple[int, int, int, bytes]


class McapFile:
    """A new MCAP file; never an existing one.

    Parameters
    ----------
    path : Path
        Must not exist.
    library : str
        Name and version of the writer.
    compression_level : int
        Of zstandard; 0 stores chunks as they are.

    Raises
    ------
    OSError
        When the file cannot be made.
    """

    def __init__(self, path: Path, library: str, compression_level: int = 1) -> None:
        self._file = io.FileIO(path, "x+")
        self._end = 0
        self._compress = (
            zstandard.ZstdCompressor(level=compression_level).compress
            if compression_level
            else None
        )
        self._schemas: dict[tuple[str, str], Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._undefined: list[McapRecord] = []
        self._defined_in: dict[int, list[McapRecord]] = {}
        self._counts: dict[int, int] = {}
        # Chunk indexes are kept as bytes: a long session has many of them.
        self._chunks: list[bytes] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        try:
            self._append(MAGIC + record_bytes(Header("ros2", library)))
        except OSError:
            self._file.close()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._end

    @property
    def message_counts(self) -> dict[int, int]:
        """Number of messages in the file, by channel id."""
        return dict(self._counts)

    @property
    def time_range(self) -> tuple[int, int]:
        """First and last log time in the file, ns; zeros when it is empty."""
        if not self._chunks:
            return 0, 0
        starts, ends = zip(*(_TIMES.unpack_from(chunk, 9) for chunk in self._chunks), strict=True)
        return min(starts), max(ends)

    @property
    def start(self) -> int | None:
        """First log time in the file, ns; None when it is empty."""
        return int(_TIMES.unpack_from(self._chunks[0], 9)[0]) if self._chunks else None

    @property
    def removed(self) -> bool:
        """Whether the file has been deleted under us."""
        return os.fstat(self._file.fileno()).st_nlink == 0

    def add_channel(
        self,
        topic: str,
        schema_name: str,
        schema_text: str,
        metadata: Mapping[str, str],
        encodings: tuple[str, str] = ("cdr", "ros2msg"),
    ) -> int:
        """Return the id of a new channel; its definition goes out with the next chunk.

        `encodings` are those of the messages and of the schema.
        """
        schema = self._schemas.get((schema_name, schema_text))
        if schema is None:
            schema = Schema(
                id=len(self._schemas) + 1,
                name=schema_name,
                encoding=encodings[1],
                data=schema_text.encode(),
            )
            self._schemas[schema_name, schema_text] = schema
            self._undefined.append(schema)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encodings[0],
            schema_id=schema.id,
            metadata=dict(metadata),
        )
        self._channels[channel.id] = channel
        self._counts[channel.id] = 0
        self._undefined.append(channel)
        return channel.id

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment; only before the first message."""
        self._before_messages()
        record = record_bytes(Attachment(0, 0, name, media_type, data))
        index = AttachmentIndex(self._end, len(record), 0, 0, len(data), name, media_type)
        self._append(record)
        self._attachments.append(index)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record; only before the first message."""
        self._before_messages()
        record = record_bytes(Metadata(name, dict(values)))
        index = MetadataIndex(self._end, len(record), name)
        self._append(record)
        self._metadata.append(index)

    def write_chunk(
        self, entries: Sequence[Entry], pause: Callable[[], object] = lambda: None
    ) -> None:
        """Write messages as one chunk, all or none.

        Parameters
        ----------
        entries : sequence of Entry
        pause : callable
            Called between pieces of the work, none of which takes long.

        Raises
        ------
        OSError
            When the disk refuses; the file is then as it was before.
        """
        if not entries:
            return
        definitions = b"".join(map(record_bytes, self._undefined))
        parts, offset = [definitions], len(definitions)
        indexes: dict[int, list[tuple[int, int]]] = {}
        pack = _MESSAGE.pack
        for number, (channel, sequence, time, data) in enumerate(entries):
            if number % _FEW == 0:
                pause()
            length = _MESSAGE_FIXED + len(data)
            parts += (pack(Opcode.MESSAGE, length, channel, sequence, time, time), data)
            indexes.setdefault(channel, []).append((time, offset))
            offset += 9 + length
        pause()
        raw = b"".join(parts)
        pause()
        stored = raw if self._compress is None else self._compress(raw)
        pause()
        times = [entry[2] for entry in entries]
        first, last = min(times), max(times)
        compression = "" if self._compress is None else "zstd"
        chunk = record_bytes(
            Chunk(
                compression=compression,
                data=stored,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(raw),
                uncompressed_size=len(raw),
            )
        )
        tail, offsets = [], {}
        position = self._end + len(chunk)
        for channel, records in indexes.items():
            pause()
            offsets[channel] = position
            tail.append(message_index(channel, records))
            position += len(tail[-1])
        pause()
        index = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=self._end,
            compression=compression,
            compressed_size=len(stored),
            message_end_time=last,
            message_index_length=position - self._end - len(chunk),
            message_index_offsets=offsets,
            message_start_time=first,
            uncompressed_size=len(raw),
        )
        self._append(b"".join((chunk, *tail)))
        if self._undefined:
            self._defined_in[len(self._chunks)] = self._undefined
            self._undefined = []
        self._chunks.append(record_bytes(index))
        for channel, records in indexes.items():
            self._counts[channel] += len(records)

    def drop_last_chunk(self) -> int:
        """Cut the last chunk off the file; return how many messages it held."""
        record = io.BytesIO(self._chunks.pop()[9:])
        index = ChunkIndex.read(ReadDataStream(record))
        self._undefined = self._defined_in.pop(len(self._chunks), []) + self._undefined
        dropped = 0
        for channel, offset in index.message_index_offsets.items():
            self._file.seek(offset + 1)
            (length,) = struct.unpack("<Q", self._file.read(8))
            count = (length - _INDEX_FIXED) // 16
            self._counts[channel] -= count
            dropped += count
        self._end = index.chunk_start_offset
        self._cut()
        return dropped

    def finish(
        self,
        closing_metadata: Callable[[], tuple[str, Mapping[str, str]]],
        make_room: bool = True,
    ) -> int:
        """Write the summary and close the file; return how many messages made room for it.

        Parameters
        ----------
        closing_metadata : callable
            Gives name and values of a last metadata record, after the messages; may write
            a file that has to go with it, and is called again when there was no room.
        make_room : bool
            Whether messages may make room; if not, the file stays open when there is none.

        Raises
        ------
        OSError
            When even an empty file has no room; the messages written stay readable.
        """
        dropped, step = 0, 1
        while True:
            try:
                self._append(self._closing(*closing_metadata()))
            except OSError as error:
                if not (make_room and self._chunks) or error.errno not in NO_ROOM:
                    raise
                # In growing steps: the summary of a long session is long.
                dropped += sum(self.drop_last_chunk() for _ in range(min(step, len(self._chunks))))
                step *= 2
            else:
                self._file.close()
                return dropped

    def abandon(self) -> None:
        """Close the file without a summary."""
        self._file.close()

    def _closing(self, name: str, values: Mapping[str, str]) -> bytes:
        closing = record_bytes(Metadata(name, dict(values)))
        metadata = [*self._metadata, MetadataIndex(self._end, len(closing), name)]
        first, last = self.time_range
        counts = {channel: n for channel, n in self._counts.items() if n}
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=counts,
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            metadata_count=len(metadata),
            message_start_time=first,
            message_end_time=last,
            schema_count=len(self._schemas),
        )
        groups = [
            (Opcode.SCHEMA, map(record_bytes, self._schemas.values())),
            (Opcode.CHANNEL, map(record_bytes, self._channels.values())),
            (Opcode.STATISTICS, [record_bytes(statistics)]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, map(record_bytes, self._attachments)),
            (Opcode.METADATA_INDEX, map(record_bytes, metadata)),
        ]
        return closing + ending(self._end + len(closing), groups)

    def _before_messages(self) -> None:
        if self._chunks:
            raise SessionError("attachments and metadata come before the first message")

    def _append(self, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError:
            self._cut()
            raise
        self._end += len(data)

    def _cut(self) -> None:
        self._file.truncate(self._end)
        self._file.seek(self._end)
