# SPDX-License-Identifier: Apache-2.0
"""Which topic of a foreign bag is what, and how its numbers become those of the model."""

from __future__ import annotations

import math
from collections.abc import Mapping as MappingType
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import yaml

from needle_sim_ros.errors import SceneError, SessionError
from needle_sim_ros.schema import build, quantity
from needle_sim_ros.session.frames import Transform

COMMAND, WRENCH, MARKERS, TIP = "base_pose", "wrench", "markers", "tip_pose"
ROLES = (COMMAND, WRENCH, MARKERS, TIP)
_ALIASES = {"stage_velocity": COMMAND, "stage": COMMAND, "base_wrench": WRENCH, "tip": TIP}


@dataclass(frozen=True)
class Frame:
    """A fixed transform as it is written: translation in m, quaternion x y z w."""

    translation: tuple[float, ...] = quantity((0.0, 0.0, 0.0), unit="m", length=(3,))
    rotation: tuple[float, ...] = quantity((0.0, 0.0, 0.0, 1.0), length=(4,))

    def transform(self) -> Transform:
        """Return the transform, its quaternion normalised."""
        norm = math.sqrt(sum(c * c for c in self.rotation))
        if norm < 1e-6:
            raise SceneError("rotation", list(self.rotation), "zero quaternion")
        return Transform(self.translation, tuple(c / norm for c in self.rotation))


@dataclass(frozen=True)
class TopicMap:
    """One topic.

    Attributes
    ----------
    topic : str
        Name in the bag.
    transform : Frame
        From the frame of the data to the tissue frame; of a wrench from the sensor's to the
        needle base.
    tool : Frame
        From the needle base (tip for ``tip_pose``) to the frame that the poses are of.
    joint : str
        Of a JointState: which joint.
    axis : tuple
        Direction, tissue frame, in which the joint moves the base.
    zero : float, optional
        Joint position at the scene's ``base.position``, m; by default the first one.
    sign : int
        -1 when the sensor shows what the needle does to the tissue.
    axes : str
        Of a force sensor: the components in the base frame that it measures, e.g. ``z``.
    bias : tuple
        What a force sensor shows without force, in its own frame: fx fy fz, or with torques.
    bias_time : float
        Instead of `bias`: the mean over the first so many seconds, before any contact.
    reference_time : float
        Markers at rest are taken from the mean over the first so many seconds.
    """

    topic: str
    transform: Frame = field(default_factory=Frame)
    tool: Frame = field(default_factory=Frame)
    joint: str = ""
    axis: tuple[float, ...] = quantity((0.0, 0.0, -1.0), length=(3,))
    zero: float | None = quantity(None, unit="m")
    sign: Literal[1, -1] = 1
    axes: str = "xyz"
    bias: tuple[float, ...] = quantity((0.0, 0.0, 0.0), unit="N", length=(3, 6))
    bias_time: float = quantity(0.0, unit="s", ge=0)
    reference_time: float = quantity(0.5, unit="s", gt=0)


@dataclass(frozen=True)
class Mapping:
    """Topics by role, and the clock that their times are read from.

    Attributes
    ----------
    clock : str
        ``header`` stamps where there are any, else log times; or ``log`` for all.
    rate : float, optional
        Ticks per second of the simulation; by default the scene's ``solver.time_step``.
    """

    base_pose: TopicMap | None = None
    wrench: TopicMap | None = None
    markers: TopicMap | None = None
    tip_pose: TopicMap | None = None
    clock: Literal["header", "log"] = "header"
    rate: float | None = quantity(None, unit="Hz", gt=0, le=1e4)

    def with_roles(self, other: Mapping) -> Mapping:
        """Return this mapping with the topics and the rate of another laid over."""
        laid: dict[str, Any] = {**other.roles(), "rate": other.rate or self.rate}
        return replace(self, **laid)

    def roles(self) -> dict[str, TopicMap]:
        """Return the topics that are mapped, by role."""
        found = {role: getattr(self, role) for role in ROLES}
        return {role: topic for role, topic in found.items() if topic is not None}


def read_mapping(path: Path | None, pairs: Sequence[str]) -> Mapping | None:
    """Read a YAML file and ``ROLE:=TOPIC`` pairs laid over it; None without either.

    Raises
    ------
    SessionError
        On what is neither a role, a topic, nor an admissible value.
    """
    if path is None and not pairs:
        return None
    mapping = Mapping() if path is None else _from_file(path)
    for pair in pairs:
        name, separator, topic = pair.partition(":=")
        role = _ALIASES.get(name, name)
        if not separator or not topic or role not in ROLES:
            raise SessionError(
                f"--topic {pair}: must be ROLE:=TOPIC with a role of {', '.join(ROLES)}"
            )
        known = getattr(mapping, role)
        changed = TopicMap(topic) if known is None else replace(known, topic=topic)
        laid: dict[str, Any] = {role: changed}
        mapping = replace(mapping, **laid)
    return mapping


def _from_file(path: Path) -> Mapping:
    try:
        data: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise SessionError(f"mapping {path}: cannot be read: {error}") from None
    except yaml.YAMLError as error:
        words = " ".join(str(error).split())
        raise SessionError(f"mapping {path}: not valid YAML: {words}") from None
    if isinstance(data, MappingType):
        data = {
            _ALIASES.get(str(k), k): {"topic": v} if k != "clock" and isinstance(v, str) else v
            for k, v in data.items()
        }
    try:
        mapping = build(Mapping, data)
        for topic in mapping.roles().values():
            topic.transform.transform(), topic.tool.transform()
            if not topic.axes or not set(topic.axes) <= set("xyz"):
                raise SceneError("axes", topic.axes, "must be letters of xyz")
    except SceneError as error:
        raise SessionError(f"mapping {path}: {error}") from None
    return mapping
