# SPDX-License-Identifier: Apache-2.0
"""Everything readable of damaged files, written into a new session."""

from __future__ import annotations

import shutil
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
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
    """What could not be read: file, place, bytes, messages if it is known how many, and why."""

    file: str
    offset: int
    length: int
    messages: int | None
    reason: str


@dataclass(eq=False)
class Salvaged:
    """What became of a session's files.

    Parameters
    ----------
    folder : Path
        The new session.
    messages : dict of str to int
        By topic.
    losses : list of Loss
        In the order of the files.
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

    source: Source
    name: str
    definitions: Definitions = field(default_factory=Definitions)
    summary: Definitions = field(default_factory=Definitions)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    pieces: int = 0


def salvage(files: Sequence[Path], folder: Path) -> Salvaged:
    """Write what can be read of a session's files into a new session and read that again.

    Parameters
    ----------
    files : sequence of Path
        In the order in which they were recorded; only read.
    folder : Path
        Made here; must not exist.

    Raises
    ------
    SessionError
        When nothing of it is MCAP, or the new session cannot be written or is not read
        back as it was written; then there is no new folder.
    """
    with ExitStack() as stack:
        surveys = [_surveyed(stack.enter_context(Source(file)), file.name) for file in files]
        if all(map(_is_foreign, surveys)):
            raise SessionError(f"{files[0]}: not an MCAP file")
        bag = Bag(folder)
        try:
            result, tally = _written(bag, surveys)
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


def _is_foreign(survey: _Survey) -> bool:
    """Return whether nothing of a file is MCAP."""
    lost = survey.losses
    return bool(lost) and lost[0].offset == 0 and not survey.pieces and lost[0].reason != CUT_OFF


def _surveyed(source: Source, name: str) -> _Survey:
    survey, lost_chunk, summary = _Survey(source, name), False, False
    for piece in walk(source):
        if isinstance(piece, Damage):
            survey.losses.append(Loss(name, piece.offset, piece.length, None, piece.reason))
            lost_chunk = piece.length > 0
            continue
        survey.pieces += 1
        content = piece.content
        if piece.opcode == Opcode.MESSAGE_INDEX:
            if lost_chunk and len(content) >= _INDEX_FIXED:
                last = survey.losses[-1]
                count = (last.messages or 0) + (len(content) - _INDEX_FIXED) // _INDEX_ENTRY
                survey.losses[-1] = replace(last, messages=count)
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
        length = piece.end - piece.offset
        survey.losses.append(Loss(survey.name, piece.offset, length, None, "a record is damaged"))


def _written(bag: Bag, surveys: Sequence[_Survey]) -> tuple[Salvaged, _Tally]:
    result = Salvaged(bag.folder, losses=[loss for survey in surveys for loss in survey.losses])
    for attachment in _put_right(surveys, result):
        bag.file.add_attachment(attachment.name, attachment.media_type, attachment.data)
    metadata: dict[str, dict[str, str]] = {}
    for survey in surveys:
        metadata = {**survey.metadata, **metadata}
    for name, values in metadata.items():
        if name != "rosbag2":  # the new file has its own
            bag.file.add_metadata(name, values)
    topics = _Topics(bag)
    tally: defaultdict[str, tuple[int, int]] = defaultdict(lambda: (0, 0))
    unknown = 0
    for survey in surveys:
        copies = {number: topics.copied(number, survey) for number in survey.definitions.channels}
        for entries in _messages(survey.source):
            known: list[Entry] = []
            for number, sequence, time, data in entries:
                if number not in copies:
                    copies[number] = topics.copied(number, survey)
                copy = copies[number]
                if copy is None:
                    unknown += 1
                    continue
                known.append((copy, sequence, time, data))
                topic = topics.names[copy]
                count, crc = tally[topic]
                tally[topic] = (count + 1, zlib.crc32(data, crc))
            bag.write(known)
    if bag.close():
        raise SessionError(f"cannot write {bag.folder}: no room")
    if unknown:
        result.notes.append(f"{unknown} messages belong to topics whose definition is lost")
    result.messages = {topic: count for topic, (count, _) in tally.items()}
    return result, dict(tally)


def _put_right(surveys: Sequence[_Survey], result: Salvaged) -> list[Attachment]:
    """Make description and scene agree, and say what of them is missing.

    Returns the attachments, each once; of several scenes the one that is noted stands first.
    """
    found = {(a.name, a.data): a for survey in surveys for a in survey.attachments}
    attachments = list(found.values())
    about = next((s.metadata[ABOUT] for s in surveys if ABOUT in s.metadata), None)
    scenes = [a for a in attachments if a.name == SCENE_FILE]
    result.has_scene = bool(about) and bool(scenes)
    if about is None:
        result.notes.append("the session's description is lost: it cannot be replayed")
    if not scenes:
        result.notes.append("the scene is lost: it cannot be replayed")
    if about is None or not scenes:
        return attachments
    digests = [sha256(scene.data).hexdigest() for scene in scenes]
    noted = about.get("scene_sha256")
    if noted not in digests:
        # The attachment's own checksum holds: it is the note that is wrong or missing.
        about["scene_sha256"] = noted = digests[0]
        result.notes.append("the noted checksum of the scene did not fit and was made new")
    scene = scenes[digests.index(noted)]
    return [scene, *(a for a in attachments if a.name != SCENE_FILE)]


class _Topics:
    """The channels of the new bag; the same topic of several files is one."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._numbers: dict[tuple[str, str, str, bytes], int] = {}
        self.names: dict[int, str] = {}

    def copied(self, number: int, survey: _Survey) -> int | None:
        """Return the new id of a file's channel; None when its definition is lost."""
        found, spare = survey.definitions, survey.summary
        channel = found.channels.get(number) or spare.channels.get(number)
        if channel is None:
            return None
        schema = found.schemas.get(channel.schema_id) or spare.schemas.get(channel.schema_id)
        if schema is None:
            return None
        key = (channel.topic, channel.message_encoding, schema.name, schema.data)
        if key not in self._numbers:
            try:
                self._numbers[key] = self._bag.copy_topic(channel, schema)
            except UnicodeDecodeError:
                return None
            self.names[self._numbers[key]] = channel.topic
        return self._numbers[key]


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
