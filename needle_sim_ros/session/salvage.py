# SPDX-License-Identifier: Apache-2.0
"""Everything readable of a damaged file, written into a new session."""

from __future__ import annotations

import shutil
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.bag import Bag
from needle_sim_ros.session.content import (
    MESSAGE_HEAD,
    UNREADABLE,
    Definitions,
    read_attachment,
    read_metadata,
)
from needle_sim_ros.session.mcap_chunk import records_in
from needle_sim_ros.session.mcap_file import Entry
from needle_sim_ros.session.mcap_walk import CUT_OFF, Damage, Piece, Source, walk
from needle_sim_ros.session.writer import ABOUT, SCENE_FILE

_INDEX_FIXED, _INDEX_ENTRY = 6, 16
_Tally = dict[str, tuple[int, int]]  # number of messages and checksum of their bytes, by topic


@dataclass(frozen=True)
class Loss:
    """What could not be read: place, bytes, messages if it is known how many, and why."""

    offset: int
    length: int
    messages: int | None
    reason: str


@dataclass(eq=False)
class Salvaged:
    """What became of a file.

    Parameters
    ----------
    folder : Path
        The new session.
    messages : dict of str to int
        By topic.
    losses : list of Loss
        In the order of the file.
    notes : list of str
        What else was found or put right.
    has_scene : bool
        Whether scene and description survived, without which it cannot be replayed.
    """

    folder: Path
    messages: dict[str, int] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    has_scene: bool = False


@dataclass(eq=False)
class _Survey:
    """First pass: definitions, what stands beside the messages, and what is lost."""

    definitions: Definitions = field(default_factory=Definitions)
    summary: Definitions = field(default_factory=Definitions)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    pieces: int = 0


def salvage(file: Path, folder: Path) -> Salvaged:
    """Write what can be read of a file into a new session and read that again.

    Parameters
    ----------
    file : Path
        Only read.
    folder : Path
        Made here; must not exist.

    Raises
    ------
    SessionError
        When nothing of it is MCAP, or the new session cannot be written or is not read
        back as it was written; then there is no new folder.
    """
    with Source(file) as source:
        survey = _surveyed(source)
        foreign = survey.losses and survey.losses[0].offset == 0
        if foreign and not survey.pieces and survey.losses[0].reason != CUT_OFF:
            raise SessionError(f"{file}: not an MCAP file")
        bag = Bag(folder)
        try:
            result, tally = _written(bag, source, survey)
            _check_read_again(next(folder.glob("*.mcap")), tally)
        except OSError as error:
            bag.file.abandon()
            shutil.rmtree(folder, ignore_errors=True)
            raise SessionError(f"cannot write {folder}: {error.strerror}") from error
        except BaseException:
            bag.file.abandon()
            shutil.rmtree(folder, ignore_errors=True)
            raise
    return result


def _surveyed(source: Source) -> _Survey:
    survey, lost_chunk, summary = _Survey(), False, False
    for piece in walk(source):
        if isinstance(piece, Damage):
            survey.losses.append(Loss(piece.offset, piece.length, None, piece.reason))
            lost_chunk = piece.length > 0
            continue
        survey.pieces += 1
        content = piece.content
        if piece.opcode == Opcode.MESSAGE_INDEX:
            if lost_chunk and len(content) >= _INDEX_FIXED:
                last = survey.losses[-1]
                count = (last.messages or 0) + (len(content) - _INDEX_FIXED) // _INDEX_ENTRY
                survey.losses[-1] = Loss(last.offset, last.length, count, last.reason)
            continue
        lost_chunk = False
        summary = summary or piece.opcode == Opcode.DATA_END
        if piece.opcode == Opcode.CHUNK:
            for opcode, begin, end in records_in(content):
                if opcode != Opcode.MESSAGE:
                    survey.definitions.add(opcode, content[begin:end])
        elif piece.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            (survey.summary if summary else survey.definitions).add(piece.opcode, content)
        else:
            _take(survey, piece)
    return survey


def _take(survey: _Survey, piece: Piece) -> None:
    """Note an attachment or a metadata record."""
    try:
        if piece.opcode == Opcode.ATTACHMENT:
            survey.attachments.append(read_attachment(piece.content))
        elif piece.opcode == Opcode.METADATA:
            record = read_metadata(piece.content)
            survey.metadata[record.name] = dict(record.metadata)
    except UNREADABLE:
        loss = Loss(piece.offset, piece.end - piece.offset, None, "a record is damaged")
        survey.losses.append(loss)


def _written(bag: Bag, source: Source, survey: _Survey) -> tuple[Salvaged, _Tally]:
    result = Salvaged(bag.folder, losses=survey.losses)
    _put_right(survey, result)
    for attachment in survey.attachments:
        bag.file.add_attachment(attachment.name, attachment.media_type, attachment.data)
    for name, values in survey.metadata.items():
        if name != "rosbag2":  # the new file has its own
            bag.file.add_metadata(name, values)
    copies: dict[int, int | None] = {}
    topics: dict[int, str] = {}
    for number in survey.definitions.channels:
        copies[number] = _copied(bag, number, survey, topics)
    tally: defaultdict[str, tuple[int, int]] = defaultdict(lambda: (0, 0))
    unknown = 0
    for entries in _messages(source):
        known: list[Entry] = []
        for number, sequence, time, data in entries:
            if number not in copies:
                copies[number] = _copied(bag, number, survey, topics)
            copy = copies[number]
            if copy is None:
                unknown += 1
                continue
            known.append((copy, sequence, time, data))
            count, crc = tally[topics[copy]]
            tally[topics[copy]] = (count + 1, zlib.crc32(data, crc))
        bag.write(known)
    if bag.close():
        raise SessionError(f"cannot write {bag.folder}: no room")
    if unknown:
        result.notes.append(f"{unknown} messages belong to topics whose definition is lost")
    result.messages = {topic: count for topic, (count, _) in tally.items()}
    return result, dict(tally)


def _put_right(survey: _Survey, result: Salvaged) -> None:
    """Make description and scene agree, and say what of them is missing."""
    about = survey.metadata.get(ABOUT)
    scene = next((a.data for a in survey.attachments if a.name == SCENE_FILE), None)
    result.has_scene = bool(about) and scene is not None
    if about is None:
        result.notes.append("the session's description is lost: it cannot be replayed")
    if scene is None:
        result.notes.append("the scene is lost: it cannot be replayed")
    if about is not None and scene is not None:
        digest = sha256(scene).hexdigest()
        if about.get("scene_sha256") != digest:
            # The attachment's own checksum holds: it is the note that is wrong or missing.
            about["scene_sha256"] = digest
            result.notes.append("the noted checksum of the scene did not fit and was made new")


def _copied(bag: Bag, number: int, survey: _Survey, topics: dict[int, str]) -> int | None:
    """Return the new id of a channel; None when its definition is lost."""
    found, spare = survey.definitions, survey.summary
    channel = found.channels.get(number) or spare.channels.get(number)
    if channel is None:
        return None
    schema = found.schemas.get(channel.schema_id) or spare.schemas.get(channel.schema_id)
    if schema is None:
        return None
    try:
        copy = bag.copy_topic(channel, schema)
    except UnicodeDecodeError:
        return None
    topics[copy] = channel.topic
    return copy


def _messages(source: Source) -> Iterator[list[Entry]]:
    """Yield the messages of each chunk, or one that stands alone."""
    head = MESSAGE_HEAD
    for piece in walk(source):
        if isinstance(piece, Damage) or piece.opcode not in (Opcode.CHUNK, Opcode.MESSAGE):
            continue
        data = piece.content
        parts = records_in(data) if piece.opcode == Opcode.CHUNK else [(piece.opcode, 0, len(data))]
        entries = []
        for opcode, begin, end in parts:
            if opcode == Opcode.MESSAGE and end - begin >= head.size:
                channel, sequence, time, _ = head.unpack_from(data, begin)
                entries.append((channel, sequence, time, data[begin + head.size : end]))
        yield entries


def _check_read_again(file: Path, written: _Tally) -> None:
    """Read a new file by its index with the reader of the `mcap` package, and compare."""
    found: defaultdict[str, tuple[int, int]] = defaultdict(lambda: (0, 0))
    try:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(log_time_order=False):
                count, crc = found[channel.topic]
                found[channel.topic] = (count + 1, zlib.crc32(message.data, crc))
            list(reader.iter_attachments())
            list(reader.iter_metadata())
    except (McapError, ValueError) as error:
        raise SessionError(f"{file} is not read back: {error}") from error
    if dict(found) != written:
        raise SessionError(f"{file} is not read back as it was written")
