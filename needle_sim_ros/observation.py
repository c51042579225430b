# SPDX-License-Identifier: Apache-2.0
"""What can be seen after a tick; costly members are computed when first read."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.interaction.state import ContactState
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
    """

    time: float
    process: Process
    insertion_depth: float
    base_position: Vector
    base_orientation: Vector
    _scene: Scene = field(repr=False)
    _pose: BasePose = field(repr=False)
    _contact: ContactState = field(repr=False)
    _dynamics: Dynamics = field(repr=False)
    _tissue: Any = field(repr=False)
    _markers: Vector = field(repr=False)
    _empty: ResponseTable = field(repr=False)

    def _bent(self, at: Vector) -> Vector:
        """Lateral deflection at arclengths (n,), shape (d - 1, n), m."""
        contact, needle = self._contact, self._scene.needle
        if len(contact.arclength) == 0:
            return np.zeros((len(contact.lateral), len(at)))
        per_force = beam.flexibility(at, contact.arclength, needle.flexural_rigidity)
        return np.asarray(-(contact.lateral @ per_force.T))

    @cached_property
    def _tip_bent(self) -> Vector:
        # all forces act between clamp and tip: a = s_k, b = L in the flexibility
        s, needle = self._contact.arclength, self._scene.needle
        per_force = s * s * (3.0 * needle.length - s)
        return np.asarray(self._contact.lateral @ per_force / (-6.0 * needle.flexural_rigidity))

    def _world(self, vectors: Vector) -> Vector:
        """Put vectors (..., d) of the mesh into the world (..., 3)."""
        if vectors.shape[-1] == 3:
            return vectors
        world = np.zeros((*vectors.shape[:-1], 3))
        world[..., 0] = vectors[..., 0]
        world[..., 2] = vectors[..., 1]
        return world

    def _in_base(self, lateral: Vector, axial: Vector) -> Vector:
        """Compose vectors (..., 3) of the base frame from lateral (d - 1, ...) and axial (...)."""
        vectors = np.zeros((*np.shape(axial), 3))
        for i, component in enumerate(lateral):
            vectors[..., i] = component
        vectors[..., 2] = axial
        return vectors

    @cached_property
    def tip_deflection(self) -> Vector:
        """Deflection of the tip from the undeflected needle, base frame, z = 0, (3,), m."""
        return self._in_base(self._tip_bent, np.zeros(()))

    @cached_property
    def tip_position(self) -> Vector:
        """Position of the tip, tissue frame, (3,), m."""
        pose, length = self._pose, self._scene.needle.length
        place = pose.origin + length * pose.axial + self._tip_bent @ pose.lateral
        return self._world(place)

    @cached_property
    def tip_slope(self) -> Vector:
        """Slopes of the deflected needle at the tip along base x and y, (2,)."""
        contact, needle = self._contact, self._scene.needle
        slopes = np.zeros(2)
        if len(contact.arclength):
            at = np.array([needle.length])
            per_force = beam.slope_flexibility(at, contact.arclength, needle.flexural_rigidity)
            slopes[: len(contact.lateral)] = -(contact.lateral @ per_force[0])
        return slopes

    @cached_property
    def base_force(self) -> Vector:
        """What the tissue does to the needle, at the base, base frame, (3,), N.

        Pushing in gives z < 0.
        """
        contact = self._contact
        return self._in_base(
            -contact.lateral.sum(axis=1), np.array(-(contact.friction.sum() + contact.tip))
        )

    @cached_property
    def base_torque(self) -> Vector:
        """Torque of the tissue on the needle about the base, base frame, (3,), N m."""
        contact = self._contact
        if contact.active == 0:
            return np.zeros(3)
        # r x F with r = (lateral, s) and F = (-q, -f): moments of both about x and y
        held = self._held_bent
        count = held.shape[1]
        moment = -(contact.lateral @ contact.arclength)  # of lateral forces, per direction
        moment += held @ contact.friction[:count]
        # friction on what is ahead of the tip acts at the tip
        moment += self._tip_bent * (float(contact.friction[count:].sum()) + contact.tip)
        torque = np.zeros(3)
        torque[1] = moment[0]
        if len(moment) == 2:
            torque[0] = -moment[1]
            torque[2] = float(held[1] @ contact.lateral[0] - held[0] @ contact.lateral[1])
        return torque

    @cached_property
    def _held_bent(self) -> Vector:
        """Lateral deflection where the lateral forces act, shape (d - 1, k), m."""
        contact, rigidity = self._contact, self._scene.needle.flexural_rigidity
        return -beam.own_deflection(contact.arclength, contact.lateral, rigidity)

    @property
    def friction_force(self) -> float:
        """Sum of the axial friction on the tissue, positive when pushing in, N."""
        return float(self._contact.friction.sum())

    @property
    def tip_force(self) -> float:
        """Axial force of the tip on the tissue, N."""
        return float(self._contact.tip)

    @cached_property
    def contact_points(self) -> Vector:
        """Reference positions of the inserted track points and, last, the tip, (k, 3), m."""
        contact = self._contact
        if contact.track is None or contact.active == 0:
            return np.zeros((0, 3))
        if contact.touching:
            return self._world(contact.track.points[:1])
        points = contact.track.points[: len(contact.arclength)]
        return self._world(np.vstack([points, contact.track.at(contact.depth)]))

    @cached_property
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

    @cached_property
    def marker_displacements(self) -> Vector:
        """Displacements of the markers, tissue frame, (n, 3), m."""
        contact = self._contact
        if len(self._markers) == 0:
            return np.zeros((0, 3))
        if contact.track is None:
            table = self._empty
            forces = np.zeros((0, len(self._pose.axial)))
        else:
            table, forces = contact.track.table, contact.forces
        moved = self._dynamics.at_readers(self._tissue, table, forces)
        return self._world(moved.reshape(len(self._markers), -1))

    @cached_property
    def marker_positions(self) -> Vector:
        """Positions of the markers now, tissue frame, (n, 3), m."""
        return np.asarray(self._markers + self.marker_displacements)

    @cached_property
    def needle_points(self) -> Vector:
        """The deflected needle from base to tip, tissue frame, (m, 3), m."""
        needle, pose = self._scene.needle, self._pose
        at = np.linspace(0.0, needle.length, _POLYLINE)
        axis = pose.origin + at[:, None] * pose.axial + self._bent(at).T @ pose.lateral
        return self._world(axis)
