# SPDX-License-Identifier: Apache-2.0
"""Numbers out of the CDR bytes of many messages of one topic at once.

Decoding message by message costs 40 us each in Python. The messages of one of our
topics differ in their numbers only, so that their bytes are the rows of an array.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.session.cdr import ENCAPSULATION

Array = NDArray[np.float64]
_UINT32 = struct.Struct("<I")
_HEADER = 12  # stamp and length of the frame id
_FLOAT64 = 12  # bytes of a message that is one double
_CLOUD_DOUBLES = 24  # x y z dx dy dz of a point, 4 bytes each


def stamped_doubles(messages: Sequence[bytes], count: int) -> Array:
    """Return the numbers of messages that are a header and doubles, (n, count).

    Raises
    ------
    ValueError
        When a message is no such one.
    """
    if not messages:
        return np.zeros((0, count))
    offset = _after_header(messages[0], 8)
    rows = _rows(messages)
    if rows is None or not _alike(rows, slice(0, 2), slice(_HEADER, _HEADER + 4)):
        return np.vstack([_doubles(m, _after_header(m, 8), count) for m in messages])
    if offset + 8 * count > rows.shape[1]:
        raise ValueError("a message is too short")
    return np.ascontiguousarray(rows[:, offset : offset + 8 * count]).view("<f8")


def float64s(messages: Sequence[bytes]) -> Array:
    """Return the numbers of `std_msgs/Float64` messages, (n,)."""
    rows = _rows(messages) if messages else None
    if rows is None or rows.shape[1] < _FLOAT64 or not _alike(rows, slice(0, 2)):
        return np.array([_doubles(m, 4, 1)[0] for m in messages], dtype=float)
    _checked(messages[0])
    return np.ascontiguousarray(rows[:, 4:_FLOAT64]).view("<f8")[:, 0]


def texts(messages: Sequence[bytes]) -> list[str]:
    """Return the texts of `std_msgs/String` messages."""
    known: dict[bytes, str] = {}
    for message in messages:
        if message not in known:
            (length,) = _UINT32.unpack_from(_checked(message), 4)
            if len(message) < 8 + length:
                raise ValueError("a message is too short")
            known[message] = message[8 : 8 + max(length - 1, 0)].decode()
    return [known[message] for message in messages]


def clouds(messages: Sequence[bytes]) -> NDArray[np.float32]:
    """Return the first six float32 of every point of `PointCloud2` messages, (n, m, 6).

    Raises
    ------
    ValueError
        When the messages have different numbers of points.
    """
    if not messages:
        return np.zeros((0, 0, 6), dtype=np.float32)
    begin, step, size = _cloud_layout(messages[0])
    layout, total = messages[0][_HEADER:begin], len(messages[0])
    if all(len(m) == total and m[_HEADER:begin] == layout for m in messages):
        joined = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), total)
        return _points(joined[:, begin : begin + size], step)
    parts = []
    for message in messages:
        begin, step, size = _cloud_layout(message)
        row = np.frombuffer(message, dtype=np.uint8)[None, begin : begin + size]
        parts.append(_points(row, step))
    if len({part.shape for part in parts}) > 1:
        raise ValueError("the number of markers changes")
    return np.concatenate(parts)


def _points(rows: NDArray[np.uint8], step: int) -> NDArray[np.float32]:
    count = rows.shape[1] // step if step else 0
    if count == 0:
        return np.zeros((len(rows), 0, 6), dtype=np.float32)
    points = rows.reshape(len(rows), count, step)[:, :, :_CLOUD_DOUBLES]
    return np.ascontiguousarray(points).view("<f4")


def _cloud_layout(message: bytes) -> tuple[int, int, int]:
    """Return where the points begin, the bytes of a point, and the bytes of all."""
    unpack = _UINT32.unpack_from
    try:
        position = _after_header(message, 4) + 8  # height, width
        (fields,) = unpack(message, position)
        position += 4
        for _ in range(fields):
            (length,) = unpack(message, position)
            position = _aligned(position + 4 + length, 4) + 4  # name, offset
            position = _aligned(position + 1, 4) + 4  # datatype, count
        position = _aligned(position + 1, 4)  # is_bigendian
        (step,) = unpack(message, position)
        (size,) = unpack(message, position + 8)
    except struct.error:
        raise ValueError("a point cloud is too short") from None
    begin = position + 12
    if begin + size > len(message) or (size and (step < _CLOUD_DOUBLES or size % step)):
        raise ValueError("a point cloud has no room for its points")
    return begin, step, size


def _checked(message: bytes) -> bytes:
    if message[:2] != ENCAPSULATION[:2] or len(message) < 8:
        raise ValueError("a message is not little-endian CDR")
    return message


def _after_header(message: bytes, alignment: int) -> int:
    if len(_checked(message)) < 4 + _HEADER:
        raise ValueError("a message is too short")
    (length,) = _UINT32.unpack_from(message, _HEADER)
    return _aligned(4 + _HEADER + int(length), alignment)


def _aligned(position: int, alignment: int) -> int:
    return position + (4 - position) % alignment


def _doubles(message: bytes, offset: int, count: int) -> Array:
    if offset + 8 * count > len(_checked(message)):
        raise ValueError("a message is too short")
    return np.frombuffer(message, dtype="<f8", count=count, offset=offset)


def _alike(rows: NDArray[np.uint8], *parts: slice) -> bool:
    """Tell whether all rows have the same bytes in some parts."""
    return all(bool((rows[:, part] == rows[0, part]).all()) for part in parts)


def _rows(messages: Sequence[bytes]) -> NDArray[np.uint8] | None:
    """Return the messages as rows, if they are equally long."""
    length = len(messages[0])
    if any(len(message) != length for message in messages):
        return None
    return np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), length)
