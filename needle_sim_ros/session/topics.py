# SPDX-License-Identifier: Apache-2.0
"""Messages of a foreign topic as rows of numbers with times."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from needle_sim_ros.errors import SessionError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.session.content import Content
from needle_sim_ros.session.mapping import COMMAND, MARKERS, TIP, WRENCH, TopicMap

_FLOATS = {7: "f4", 8: "f8"}
_INTEGERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4"}


@dataclass(frozen=True, eq=False)
class TopicData:
    """What a topic says.

    Attributes
    ----------
    kind : str
        Message type.
    log : ndarray, shape (n,)
        Log times, ns.
    stamps : ndarray, shape (n,)
        Header stamps, ns; zeros where there are none.
    rows : ndarray
        Poses (n, 7), twists (n, 6), joint positions (n, 1), wrenches (n, 6), or marker
        positions (n, m, 3), NaN where a marker was not seen.
    """

    kind: str
    log: NDArray[np.int64]
    stamps: NDArray[np.int64]
    rows: Vector


def read_topic(contents: Iterable[Content], role: str, mapped: TopicMap) -> TopicData:
    """Decode a topic.

    Raises
    ------
    SessionError
        When the bag does not have it, or its type cannot play the role.
    """
    kinds: set[str] = set()
    entries: list[tuple[int, Any]] = []
    everywhere: set[str] = set()
    for content in contents:
        factory = DecoderFactory()  # knows schemas by their number in one file
        for number, channel in content.channels.items():
            everywhere.add(channel.topic)
            schema = content.schemas.get(channel.schema_id)
            if channel.topic != mapped.topic or schema is None:
                continue
            kinds.add(schema.name)
            if schema.name not in _READERS[role]:
                continue
            decoder = factory.decoder_for(channel.message_encoding, schema)
            if decoder is None:
                raise SessionError(
                    f"topic {mapped.topic}: its encoding is {channel.message_encoding} with"
                    f" {schema.encoding}; cdr with ros2msg can be read"
                )
            for _, time, data in content.messages.get(number, []):
                entries.append((time, _decoded(decoder, data, mapped.topic, time)))
    _check_kind(role, mapped.topic, kinds, everywhere)
    if not entries:
        raise SessionError(f"topic {mapped.topic} ({role}): it has no message")
    entries.sort(key=lambda entry: entry[0])
    kind = kinds.pop()
    messages = [message for _, message in entries]
    kept, rows = _READERS[role][kind](messages, mapped)
    log = np.array([time for time, _ in entries], dtype=np.int64)[kept]
    stamps = np.array([_stamp(message) for message in messages], dtype=np.int64)[kept]
    return TopicData(kind, log, stamps, rows)


def cloud_points(message: Any, topic: str) -> Vector:
    """Return the points (m, 3) of a `PointCloud2`, in the order of their ids where it has some.

    Raises
    ------
    SessionError
        When its points have no x y z.
    """
    _, rows = _clouds([message], TopicMap(topic))
    return np.asarray(rows[0])


def _check_kind(role: str, topic: str, kinds: set[str], everywhere: set[str]) -> None:
    if not kinds:
        what = "no command topic" if role == COMMAND else f"no topic for {role}"
        there = ", ".join(sorted(everywhere)) or "none"
        raise SessionError(f"{what}: {topic} is not in the bag; its topics: {there}")
    allowed = _READERS[role]
    if len(kinds) > 1 or not kinds <= set(allowed):
        raise SessionError(
            f"topic {topic}: {role} cannot be {', '.join(sorted(kinds))};"
            f" can be {', '.join(allowed)}"
        )


def _decoded(decoder: Callable[[bytes], Any], data: bytes, topic: str, time: int) -> Any:
    try:
        return decoder(data)
    except Exception as error:  # whatever a damaged message makes of the decoder
        raise SessionError(
            f"topic {topic}: the message at {time * 1e-9:.3f} s cannot be decoded: {error}"
        ) from error


def _stamp(message: Any) -> int:
    if hasattr(message, "markers"):
        return max((_stamp(marker) for marker in message.markers), default=0)
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


Read = tuple[list[int], Vector]


def _each(rows: list[list[float]]) -> Read:
    return list(range(len(rows))), np.array(rows, dtype=float)


def _vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def _pose(pose: Any) -> list[float]:
    q = pose.orientation
    return [*_vector(pose.position), q.x, q.y, q.z, q.w]


def _poses(messages: list[Any], mapped: TopicMap) -> Read:
    return _each([_pose(m.pose) for m in messages])


def _transforms(messages: list[Any], mapped: TopicMap) -> Read:
    found = [m.transform for m in messages]
    return _each(
        [
            [*_vector(t.translation), t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w]
            for t in found
        ]
    )


def _twists(messages: list[Any], mapped: TopicMap) -> Read:
    return _each([[*_vector(m.twist.linear), *_vector(m.twist.angular)] for m in messages])


def _wrenches(messages: list[Any], mapped: TopicMap) -> Read:
    return _each([[*_vector(m.wrench.force), *_vector(m.wrench.torque)] for m in messages])


def _joints(messages: list[Any], mapped: TopicMap) -> Read:
    names = sorted({name for m in messages for name in m.name})
    joint = mapped.joint or (names[0] if len(names) == 1 else "")
    if joint not in names:
        raise SessionError(
            f"topic {mapped.topic}: joint {mapped.joint!r} is not in it; name one of"
            f" {', '.join(names) or 'none'}"
        )
    kept, rows = [], []
    for k, message in enumerate(messages):  # drivers of several axes may send one at a time
        if joint in message.name and message.name.index(joint) < len(message.position):
            kept.append(k)
            rows.append([message.position[message.name.index(joint)]])
    return kept, np.array(rows, dtype=float)


def _pose_arrays(messages: list[Any], mapped: TopicMap) -> Read:
    return _numbered([[(k, _vector(p.position)) for k, p in enumerate(m.poses)] for m in messages])


def _marker_arrays(messages: list[Any], mapped: TopicMap) -> Read:
    found = [
        [((m.ns, m.id), _vector(m.pose.position)) for m in array.markers if m.action == 0]
        for array in messages
    ]
    return _numbered(found)


def _clouds(messages: list[Any], mapped: TopicMap) -> Read:
    found = []
    for message in messages:
        fields = {f.name: f for f in message.fields}
        if not {"x", "y", "z"} <= set(fields):
            raise SessionError(
                f"topic {mapped.topic}: its points have no x y z but {', '.join(fields)}"
            )
        order = ">" if message.is_bigendian else "<"
        kinds = _FLOATS | _INTEGERS
        names = [n for n in ("x", "y", "z", "id") if n in fields]
        layout = np.dtype(
            {
                "names": names,
                "formats": [order + kinds[fields[n].datatype] for n in names],
                "offsets": [fields[n].offset for n in names],
                "itemsize": message.point_step,
            }
        )
        points = np.frombuffer(bytes(message.data), layout, message.width * message.height)
        places = np.column_stack([points[n].astype(float) for n in "xyz"])
        ids = points["id"].tolist() if "id" in names else range(len(points))
        found.append(list(zip(ids, places.tolist(), strict=True)))
    return _numbered(found)


def _numbered(found: list[list[tuple[Any, list[float]]]]) -> Read:
    """Put markers in the order of their ids; those not seen in a message are NaN."""
    ids = sorted({number for points in found for number, _ in points})
    column = {number: k for k, number in enumerate(ids)}
    rows = np.full((len(found), len(ids), 3), np.nan)
    for row, points in zip(rows, found, strict=True):
        for number, place in points:
            row[column[number]] = place
    return list(range(len(found))), rows


_POSES: dict[str, Callable[[list[Any], TopicMap], Read]] = {
    "geometry_msgs/msg/PoseStamped": _poses,
    "geometry_msgs/msg/TransformStamped": _transforms,
}
_READERS: dict[str, dict[str, Callable[[list[Any], TopicMap], Read]]] = {
    COMMAND: {
        **_POSES,
        "geometry_msgs/msg/TwistStamped": _twists,
        "sensor_msgs/msg/JointState": _joints,
    },
    WRENCH: {"geometry_msgs/msg/WrenchStamped": _wrenches},
    MARKERS: {
        "sensor_msgs/msg/PointCloud2": _clouds,
        "geometry_msgs/msg/PoseArray": _pose_arrays,
        "visualization_msgs/msg/MarkerArray": _marker_arrays,
    },
    TIP: _POSES,
}
