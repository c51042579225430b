# SPDX-License-Identifier: Apache-2.0
"""One insertion: where the needle enters, how it leans, how base and bevel are led."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.geometry import (
    Vector,
    from_rotation_vector,
    multiply,
    rotation_matrix,
)
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.mesh import planned_path

# gap between tip and surface when an insertion begins, m
_ABOVE = 1e-3
# angular velocity of the bevel when its roll changes, rad/s
_ROLL_RATE = math.pi / 2


@dataclass(frozen=True)
class Insertion:
    """How the base moves; the tip of an undeflected needle meets the surface at travel 0.

    Attributes
    ----------
    length : float
        Of the needle, m.
    speed : float
        Of the base along the needle, m/s.
    orientation : tuple of 4 floats
        Of the base of the scene, quaternion x y z w; inclination and roll count from it.
    entry : tuple of 2 floats
        x and y where the undeflected needle meets the surface, m.
    inclination : tuple of 2 floats
        Lean towards tissue x and y, rad.
    roll : float
        Turn of the base, and so of the bevel, about the needle's axis, rad.
    turn : float
        Second turn about the axis, made in a stop at the travel `turn_at`, rad.
    turn_at : float
        m.
    offset : tuple of 2 floats
        Sideways motion of the base at `reference` of travel, linear in travel, along base
        x and y at roll 0, m.
    reference : float
        m.
    travel : float
        How far the base goes along the needle from travel 0, m.
    """

    length: float
    speed: float
    orientation: tuple[float, ...]
    entry: tuple[float, float] = (0.0, 0.0)
    inclination: tuple[float, float] = (0.0, 0.0)
    roll: float = 0.0
    turn: float = 0.0
    turn_at: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    reference: float = 0.05
    travel: float = 0.05

    @classmethod
    def of(cls, scene: Scene, depth: float | None = None) -> Insertion:
        """Return the straight insertion that a scene plans, or one as deep as `depth`, m."""
        path = planned_path(scene)
        speeds = [math.hypot(*segment.velocity) for segment in scene.protocol]
        speed = next((v for v in speeds if v > 0), 3e-3)
        quaternion = np.array(scene.base.orientation)
        quaternion = quaternion / np.linalg.norm(quaternion)
        reach = float(path.depth if depth is None else depth)
        return cls(
            length=scene.needle.length,
            speed=speed,
            orientation=tuple(quaternion.tolist()),
            entry=(float(path.entry[0]), float(path.entry[1])),
            turn_at=reach / 2,
            reference=reach,
            travel=reach,
        )

    def with_travel(self, travel: float) -> Insertion:
        """Return the same insertion ended elsewhere."""
        return replace(self, travel=travel)

    @cached_property
    def _lean(self) -> Vector:
        a, b = self.inclination
        return multiply(from_rotation_vector([b, -a, 0.0]), self.orientation)

    @cached_property
    def _turned(self) -> Vector:
        return rotation_matrix(self._lean)

    @property
    def axis(self) -> Vector:
        """Unit vector along the needle, (3,)."""
        return np.asarray(self._turned[:, 2])

    def place(self, travel: float) -> Vector:
        """Return the base position, (3,), m."""
        turned = self._turned
        start = np.array([*self.entry, 0.0]) - self.length * turned[:, 2]
        aside = turned[:, 0] * self.offset[0] + turned[:, 1] * self.offset[1]
        return np.asarray(start + travel * turned[:, 2] + max(travel, 0.0) / self.reference * aside)

    def facing(self, travel: float) -> Vector:
        """Return the base orientation, quaternion (4,); turned where travel passes `turn_at`."""
        return self._after_turn if travel > self.turn_at else self._before_turn

    @cached_property
    def _before_turn(self) -> Vector:
        return self._rolled(self.roll)

    @cached_property
    def _after_turn(self) -> Vector:
        return self._rolled(self.roll + self.turn)

    def _rolled(self, roll: float) -> Vector:
        turned = multiply(self._lean, from_rotation_vector([0.0, 0.0, roll]))
        return np.asarray(turned / np.linalg.norm(turned))

    def command(self, travel: float) -> BaseCommand:
        """Return the pose of the base at a travel."""
        return BaseCommand(position=self.place(travel), orientation=self.facing(travel))

    @property
    def turn_time(self) -> float:
        """How long the second turn takes, s."""
        return abs(self.turn) / _ROLL_RATE

    def scene_of(self, scene: Scene, rest: float = 0.0) -> Scene:
        """Return a scene whose base and protocol make this insertion.

        Parameters
        ----------
        scene : Scene
            All else.
        rest : float
            How long the base stands still at the end, s.
        """
        axis, start = self.axis, self.place(0.0)
        velocity = self.speed * (self.place(self.reference) - start) / self.reference
        segments = [self._segment(_ABOVE, self.speed * axis)]
        stop = self.turn_at if self.turn and 0 < self.turn_at < self.travel else self.travel
        segments.append(self._segment(stop, velocity))
        if stop < self.travel:
            turning = {
                "duration": self.turn_time,
                "angular_velocity": (self.turn / self.turn_time * axis).tolist(),
            }
            segments += [turning, self._segment(self.travel - stop, velocity)]
        if rest > 0:
            segments.append({"duration": rest})
        return scene.with_changes(
            {
                "base.position": (start - _ABOVE * axis).tolist(),
                "base.orientation": self.facing(0.0).tolist(),
                "protocol": segments,
            }
        )

    def _segment(self, travel: float, velocity: Vector) -> dict[str, object]:
        return {"duration": travel / self.speed, "velocity": velocity.tolist()}
