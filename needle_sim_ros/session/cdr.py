# SPDX-License-Identifier: Apache-2.0
"""CDR bytes of the few message types that every tick writes.

Building a message object and serialising it costs 30 us in Python, packing the same
bytes with `struct` 0.6 us; the bytes are published and recorded as they are. Padding is
zero, so that equal messages give equal files. Little-endian XCDR version 1, as every
ROS 2 middleware sends it: a member is aligned to its size, counted from the end of the
4-byte encapsulation header.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

ENCAPSULATION = b"\x00\x01\x00\x00"
Packer = Callable[[int, Sequence[float]], bytes]
_SECOND = 1_000_000_000
_FLOAT32, _UINT32 = 7, 6  # sensor_msgs/PointField
_WORDS = 7  # of a point of a cloud


def text(value: str) -> bytes:
    """Return a `std_msgs/String`."""
    data = value.encode() + b"\x00"
    return ENCAPSULATION + struct.pack("<I", len(data)) + data


def float64(value: float) -> bytes:
    """Return a `std_msgs/Float64`."""
    return struct.pack("<4sd", ENCAPSULATION, value)


def clock(stamp: int) -> bytes:
    """Return a `rosgraph_msgs/Clock`; `stamp` in ns."""
    return struct.pack("<4siI", ENCAPSULATION, *divmod(stamp, _SECOND))


def header(frame_id: str) -> bytes:
    """Return how a message begins that has a header, and doubles after it; its stamp is 0."""
    frame = frame_id.encode() + b"\x00"
    room = len(frame) + (-12 - len(frame)) % 8
    return struct.pack(f"<4siII{room}s", ENCAPSULATION, 0, 0, len(frame), frame)


def stamped_doubles(frame_id: str, count: int) -> Packer:
    """Return a packer of messages that are a header and `count` doubles.

    `Vector3Stamped` has 3, `WrenchStamped` and `TwistStamped` 6, `PoseStamped` 7
    (position, quaternion x y z w). The packer takes the stamp in ns and the numbers.
    """
    after = header(frame_id)[12:]
    pack = struct.Struct(f"<4siI{len(after)}s{count}d").pack

    def encode(stamp: int, values: Sequence[float]) -> bytes:
        return pack(ENCAPSULATION, *divmod(stamp, _SECOND), after, *values)

    return encode


def read_stamped_doubles(data: bytes, count: int) -> tuple[str, tuple[float, ...]] | None:
    """Return frame id and numbers of a message that is a header and `count` doubles.

    None for anything but the plain little-endian form with an ASCII frame id and nothing
    before or after: then a real deserialiser has to say what it is.
    """
    if len(data) < 16 or data[:4] != ENCAPSULATION:
        return None
    end = 16 + int.from_bytes(data[12:16], "little")
    begin = end + (4 - end) % 8
    if len(data) != begin + 8 * count or end == 16 or data[end - 1]:
        return None
    frame = data[16 : end - 1]
    if not frame.isascii() or 0 in frame:
        return None
    return frame.decode("ascii"), struct.unpack_from(f"<{count}d", data, begin)


def blank_cloud(frame_id: str, n: int) -> bytes:
    """Return a `PointCloud2` of n points x y z dx dy dz (float32, m) and id (uint32).

    All but the ids is 0; one byte follows the points.
    """
    kinds = [(name, _FLOAT32) for name in ("x", "y", "z", "dx", "dy", "dz")] + [("id", _UINT32)]
    body = bytearray(8)  # the stamp
    _put_string(body, frame_id)
    _put(body, "<II", 4, 1, n)
    _put(body, "<I", 4, len(kinds))
    for k, (name, datatype) in enumerate(kinds):
        _put_string(body, name)
        _put(body, "<I", 4, 4 * k)
        _put(body, "<B", 1, datatype)
        _put(body, "<I", 4, 1)
    _put(body, "<B", 1, 0)
    _put(body, "<III", 4, 4 * _WORDS, 4 * _WORDS * n, 4 * _WORDS * n)
    points = np.zeros((n, _WORDS), "<u4")
    points[:, -1] = np.arange(n)
    return ENCAPSULATION + bytes(body) + points.tobytes() + b"\x01"


def marker_cloud(
    frame_id: str,
) -> Callable[[int, NDArray[np.float64], NDArray[np.float64]], bytes]:
    """Return a packer of clouds like :func:`blank_cloud`.

    The packer takes the stamp in ns, the positions (n, 3) and the displacements (n, 3).
    """
    pack_stamp = struct.Struct("<iI").pack_into
    cache: dict[int, tuple[bytearray, NDArray[np.float32]]] = {}

    def encode(
        stamp: int, positions: NDArray[np.float64], displacements: NDArray[np.float64]
    ) -> bytes:
        n = len(positions)
        if n not in cache:
            whole = bytearray(blank_cloud(frame_id, n))
            begin = len(whole) - 1 - 4 * _WORDS * n
            cache[n] = whole, np.frombuffer(whole, "<f4", _WORDS * n, begin).reshape(n, _WORDS)
        whole, numbers = cache[n]
        pack_stamp(whole, len(ENCAPSULATION), *divmod(stamp, _SECOND))
        numbers[:, :3] = positions
        numbers[:, 3:6] = displacements
        return bytes(whole)

    return encode


def _put(body: bytearray, form: str, alignment: int, *values: int) -> None:
    body.extend(bytes(-len(body) % alignment))
    body.extend(struct.pack(form, *values))


def _put_string(body: bytearray, value: str) -> None:
    data = value.encode() + b"\x00"
    _put(body, "<I", 4, len(data))
    body.extend(data)
