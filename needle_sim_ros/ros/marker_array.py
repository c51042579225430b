# SPDX-License-Identifier: Apache-2.0
"""CDR bytes of a `visualization_msgs/MarkerArray`.

As message objects the ten thousand points of a surface would hold the interpreter lock for
a tenth of a second; as bytes of an array they take a millisecond.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from needle_sim_ros.session.cdr import ENCAPSULATION
from needle_sim_ros.view.shapes import Shape

_ADD, _DELETE = 0, 2
_SECOND = 1_000_000_000


def marker_array(stamp: int, frame: str, shapes: Sequence[Shape]) -> bytes:
    """Return the message.

    Parameters
    ----------
    stamp : int
        Simulated time, ns.
    frame : str
        Frame id of all points.
    shapes : sequence of Shape
        Their names become namespaces; every id is 0.
    """
    body = _Body()
    body.put("<I", 4, len(shapes))
    for shape in shapes:
        _put_marker(body, stamp, frame, shape)
    return ENCAPSULATION + body.data


def _put_marker(body: _Body, stamp: int, frame: str, shape: Shape) -> None:
    """Append a Marker, its fields in the order of the message's definition."""
    body.put("<iI", 4, *divmod(stamp, _SECOND))
    body.string(frame)
    body.string(shape.name)
    body.put("<iii", 4, 0, int(shape.kind), _ADD if len(shape.points) else _DELETE)
    body.put("<7d", 8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # pose
    body.put("<3d", 8, *shape.scale)
    body.put("<4f", 4, *shape.colour)
    body.put("<iI", 4, 0, 0)  # lifetime: until replaced
    body.put("<?", 1, False)  # frame_locked
    body.array(shape.points, "<f8")
    body.array(np.zeros((0, 4)) if shape.colours is None else shape.colours, "<f4")
    body.string("")  # texture_resource
    body.put("<iI", 4, 0, 0)  # texture: header, format, data
    body.string("")
    body.string("")
    body.put("<I", 4, 0)
    body.put("<I", 4, 0)  # uv_coordinates
    body.string("")  # text
    body.string("")  # mesh_resource
    body.string("")  # mesh_file: name, data
    body.put("<I", 4, 0)
    body.put("<?", 1, False)  # mesh_use_embedded_materials


class _Body:
    def __init__(self) -> None:
        self.data = bytearray()

    def put(self, form: str, alignment: int, *values: float) -> None:
        self.data.extend(bytes(-len(self.data) % alignment))
        self.data.extend(struct.pack(form, *values))

    def string(self, value: str) -> None:
        data = value.encode() + b"\x00"
        self.put("<I", 4, len(data))
        self.data.extend(data)

    def array(self, rows: np.ndarray, kind: str) -> None:
        """Append a sequence of structures of equal numbers; aligned only if not empty."""
        self.put("<I", 4, len(rows))
        if len(rows):
            self.data.extend(bytes(-len(self.data) % np.dtype(kind).itemsize))
            self.data.extend(np.ascontiguousarray(rows, dtype=kind).tobytes())
