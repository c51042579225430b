# SPDX-License-Identifier: Apache-2.0
"""What can be seen after a tick; costly members are computed when first read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.interaction.readings import Readings, readings
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.lazily import lazily
from needle_sim_ros.needle import beam
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.dynamics import Dynamics
from needle_sim_ros.tissue.response import ResponseTable

_POLYLINE = 41


@dataclass(frozen=True, eq=False)
class Observation:
    """State of needle and tissue after a tick. SI units.

    Attributes
    ----------
    time : float
        Simulated time, s.
    process : Process
        FREE, CONTACT, INSERTION, HOLD or RETRACTION.
    insertion_depth : float
        Length of the needle in the tissue along the track, m.
    base_position : ndarray, shape (3,)
        Tissue frame, m.
    base_orientation : ndarray, shape (4,)
        Quaternion x y z w, base to tissue frame.
    markers : ndarray, shape (n, 3)
        Where the markers are in the tissue at rest, tissue frame, m.
    """

    time: float
    process: Process
    insertion_depth: float
    base_position: Vector
    base_orientation: Vector
    markers: Vector = field(repr=False)
    _scene: Scene = field(repr=False)
    _pose: BasePose = field(repr=False)
    _contact: ContactState = field(repr=False)
    _dynamics: Dynamics = field(repr=False)
    _tissue: Any = field(repr=False)
    _empty: ResponseTable = field(repr=False)

    def _bent(self, at: Vector) -> Vector:
        """Lateral deflection at arclengths (n,), shape (d - 1, n), m."""
        contact, needle = self._contact, self._scene.needle
        if len(contact.arclength) == 0:
            return np.zeros((len(contact.lateral), len(at)))
        per_force = beam.flexibility(at, contact.arclength, needle.flexural_rigidity)
        return np.asarray(-(contact.lateral @ per_force.T))

    @lazily
    def readings(self) -> Readings:
        """What sensors on the needle read, as tuples; the members below give them as arrays."""
        needle = self._scene.needle
        return readings(self._contact, self._pose, needle.length, needle.flexural_rigidity)

    def _world(self, vectors: Vector) -> Vector:
        """Put vectors (..., d) of the mesh into the world (..., 3)."""
        if vectors.shape[-1] == 3:
            return vectors
        world = np.zeros((*vectors.shape[:-1], 3))
        world[..., 0] = vectors[..., 0]
        world[..., 2] = vectors[..., 1]
        return world

    @lazily
    def tip_deflection(self) -> Vector:
        """Deflection of the tip from the undeflected needle, base frame, z = 0, (3,), m."""
        return np.array(self.readings.tip_deflection)

    @lazily
    def tip_position(self) -> Vector:
        """Position of the tip, tissue frame, (3,), m."""
        return np.array(self.readings.tip_position)

    @lazily
    def tip_slope(self) -> Vector:
        """Slopes of the deflected needle at the tip along base x and y, (2,)."""
        return np.array(self.readings.tip_slope)

    @lazily
    def base_force(self) -> Vector:
        """What the tissue does to the needle, at the base, base frame, (3,), N.

        Pushing in gives z < 0.
        """
        return np.array(self.readings.base_force)

    @lazily
    def base_torque(self) -> Vector:
        """Torque of the tissue on the needle about the base, base frame, (3,), N m."""
        return np.array(self.readings.base_torque)

    @property
    def friction_force(self) -> float:
        """Sum of the axial friction on the tissue, positive when pushing in, N."""
        return self.readings.friction_force

    @property
    def tip_force(self) -> float:
        """Axial force of the tip on the tissue, N."""
        return float(self._contact.tip)

    @lazily
    def contact_points(self) -> Vector:
        """Reference positions of the inserted track points and, last, the tip, (k, 3), m."""
        contact = self._contact
        if contact.track is None or contact.active == 0:
            return np.zeros((0, 3))
        if contact.touching:
            return self._world(contact.track.points[:1])
        points = contact.track.points[: len(contact.arclength)]
        return self._world(np.vstack([points, contact.track.at(contact.depth)]))

    @lazily
    def contact_forces(self) -> Vector:
        """Forces on the tissue at the contact points, tissue frame, (k, 3), N."""
        contact, pose = self._contact, self._pose
        if contact.active == 0:
            return np.zeros((0, 3))
        if contact.touching:
            return self._world(contact.forces[:1])
        held = len(contact.arclength)
        along = contact.lateral.T @ pose.lateral + np.outer(contact.friction[:held], pose.axial)
        # friction on what the tip has only begun to pass counts at the tip
        tip = contact.friction[held:].sum() + contact.tip
        return self._world(np.vstack([along, tip * pose.axial]))

    @lazily
    def marker_displacements(self) -> Vector:
        """Displacements of the markers, tissue frame, (n, 3), m."""
        return self._world(self.marker_shifts)

    @lazily
    def marker_shifts(self) -> Vector:
        """The same in the coordinates of the mesh (x z in 2D, x y z in 3D), (n, d), m."""
        if len(self.markers) == 0:
            return np.zeros((0, len(self._pose.axial)))
        moved = self._dynamics.at_readers(self._tissue, *self.loaded())
        return moved.reshape(len(self.markers), -1)

    @lazily
    def marker_positions(self) -> Vector:
        """Positions of the markers now, tissue frame, (n, 3), m."""
        return np.asarray(self.markers + self.marker_displacements)

    def tissue_field(self) -> Vector:
        """Return the displacement of all nodes of the mesh, (nodes, d), m; costs a solve."""
        return self._dynamics.everywhere(self._tissue, *self.loaded())

    def loaded(self) -> tuple[ResponseTable, Vector]:
        """Return the rows on which the tissue is loaded, and the forces on them, (n, d), N."""
        contact = self._contact
        if contact.track is None:
            return self._empty, np.zeros((0, len(self._pose.axial)))
        return contact.track.table, contact.forces

    @lazily
    def needle_points(self) -> Vector:
        """The deflected needle from base to tip, tissue frame, (m, 3), m."""
        needle, pose = self._scene.needle, self._pose
        at = np.linspace(0.0, needle.length, _POLYLINE)
        axis = pose.origin + at[:, None] * pose.axial + self._bent(at).T @ pose.lateral
        return self._world(axis)
