# SPDX-License-Identifier: Apache-2.0
"""A simulator for many "what if": quasi-static, on a coarse track, one step a track spacing.

What a rollout loses to coarse steps is not the balance of forces, which is that of the
moment, but the place where the tip's heading is taken: steps that end half a spacing behind
the last track point take it where the track wants it, and the end of an insertion then
agrees with steps a hundred times as fine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from needle_sim_ros.errors import NeedleSimError, SceneError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Scene
from needle_sim_ros.similarity import softened
from needle_sim_ros.simulator import Simulator, Snapshot
from needle_sim_ros.tick.route import Route
from needle_sim_ros.tissue.build import BuiltTissue, plane_points
from needle_sim_ros.tissue.dynamics import expand
from needle_sim_ros.tissue.mesh import planned_path, spacings

# track spacings of a rollout per track spacing of the scene, which is to be a few dozen steps;
# in 3D a coarse track bends less, and a planner would take what only the scene's reaches for
# out of reach: it keeps the scene's own
_COARSER, _COARSER_3D = 2.5, 3.2
# ... and at least so many on the planned path
_LEAST_POINTS, _LEAST_POINTS_3D = 15, 35
# spacings of the mesh within the reach to each side in 3D: unknowns grow with their square
_COLUMNS = 5
# the farthest that the base goes, or turns, in one step: spacings, rad
_FARTHEST, _MOST_TURN = 1.5, 0.3
# of a segment, short of where the heading is taken, so that the next step takes it there;
# a step that ended so near behind it needs no other
_HALFWAY, _NEAR = 0.499, 0.04
# of the way to the puncture, what is gone in one step; the rest in quarters of a spacing
_TO_PUNCTURE = 0.98
# how close to the cut a step comes, of its advance: nobody asks what slides on after a stop
_CLOSE = 0.05
# what needs another factorisation; tissue.youngs_modulus only scales the one there is
_FIXED = ("tissue.", "dimension", "solver.", "needle.length", "needle.radius", "base.", "markers")


class MaterialPoint(NamedTuple):
    """A point of the tissue whose displacement is read by the response of the whole tissue.

    Attributes
    ----------
    place : ndarray, shape (3,)
        Reference position, m.
    response : ndarray, shape (d, nodes, d)
        Displacement component a per unit force component b on each node, m/N.
    """

    place: Vector
    response: Vector


def planning_scene(scene: Scene, reach: float | None = None) -> Scene:
    """Return the quasi-static variant of a scene on which rollouts are quick.

    Parameters
    ----------
    scene : Scene
    reach : float, optional
        Half width about the planned path within which candidate paths may lie, m: there
        the mesh is as fine as on the path itself, in 3D as fine as can be afforded.
    """
    changes: dict[str, object] = {"solver.dynamics": "quasi_static", "solver.modes": 0}
    spacing = scene.solver.track_spacing
    along = scene.tissue.mesh.spacing_along
    if scene.dimension == 2:
        spacing = max(spacing, min(_COARSER * spacing, planned_path(scene).depth / _LEAST_POINTS))
        changes["tissue.mesh.spacing_along"] = spacing if along is None else max(along, spacing)
    elif reach is None:
        coarser = min(_COARSER_3D * spacing, planned_path(scene).depth / _LEAST_POINTS_3D)
        spacing = max(spacing, coarser)
    changes["solver.track_spacing"] = spacing
    if reach is not None:
        changes["markers"] = []  # a planner asks about its target alone
        across, _, band = spacings(scene)
        changes["tissue.mesh.band"] = max(reach, band)
        if scene.dimension == 3:
            changes["tissue.mesh.spacing_across"] = max(across, reach / _COLUMNS)
    return scene.with_changes(changes)


class QuickSimulator(Simulator):
    """A simulator of a quasi-static scene that takes one step for each track spacing.

    Parameters
    ----------
    scene : Scene
        As :func:`planning_scene` makes it.
    progress : callable, optional
        Called with (done, total) while the tissue is prepared.

    Raises
    ------
    NeedleSimError
        When the scene is not quasi-static.

    Attributes
    ----------
    force_scale : float
        What the forces of observations have to be multiplied by, see :meth:`changed`.
    """

    force_scale = 1.0

    def __init__(self, scene: Scene, progress: Callable[[int, int], None] | None = None) -> None:
        if scene.solver.dynamics != "quasi_static":
            raise SceneError("solver.dynamics", scene.solver.dynamics, "must be quasi_static")
        super().__init__(scene, progress)

    def _take(self, scene: Scene, built: BuiltTissue) -> None:
        super()._take(scene, built)
        self._contact_laws.close = _CLOSE
        # the next rollout is elsewhere before it would be there
        self._contact_laws.layer.prepares = False

    def _steps(self, state: Snapshot, route: Route) -> tuple[int, int, int]:
        spacing = self.scene.solver.track_spacing
        by_turn = math.ceil(route.motion.angle / _MOST_TURN - 1e-9)
        by_way = math.ceil(route.length / (_FARTHEST * spacing) - 1e-9)
        if state.contact.touching:  # nothing on the way to a puncture depends on the step
            by_way = 1
        return 1, max(1, by_way, by_turn), 0

    def next_stop(self) -> float:
        """Return how far the base should go in the next step, m.

        In the tissue to where the tip stands half a spacing behind the point to be laid.
        """
        contact, spacing = self._state.contact, self.scene.solver.track_spacing
        if not contact.inserted:
            return max(spacing / 4, self._before_puncture())
        passed = contact.depth / spacing
        ahead = math.floor(passed - _HALFWAY + _NEAR) + 1 + _HALFWAY - passed
        rate = contact.rate if contact.rate > 0.3 else 1.0
        return min(ahead / rate, _FARTHEST) * spacing

    def _before_puncture(self) -> float:
        """Return how far the base can go before the surface breaks; it dents in proportion."""
        contact, pose = self._state.contact, self._state.pose
        if contact.track is None or not contact.touching or contact.tip <= 0:
            return 0.0
        dent = self.scene.needle.length - pose.along(contact.track.points[0])
        limit = self._contact_laws.laws.at(contact.track.points[0]).puncture
        return _TO_PUNCTURE * float(dent) * (limit / contact.tip - 1.0)

    def prepare_cone(self, start: float, slope: float) -> int:
        """Prepare the tissue about the planned path for paths to any side; return the solves.

        Parameters
        ----------
        start : float
            Radius of the cone at the surface, m.
        slope : float
            Growth of its radius per depth.
        """
        path = planned_path(self.scene)
        d = self.scene.dimension
        entry = plane_points(path.entry, d)[0]
        direction = plane_points(path.direction, d)[0]
        away = self._model.coordinates.T - entry
        along = away @ direction
        aside = np.linalg.norm(away - along[:, None] * direction, axis=1)
        spacing = self.scene.solver.track_spacing
        inside = (aside <= start + slope * np.maximum(along, 0.0)) & (
            along <= path.depth + 2 * spacing
        )
        before = self._factor.solves
        self._dynamics.compliance.ensure(np.flatnonzero(inside))
        return self._factor.solves - before

    def material_point(self, place: ArrayLike) -> MaterialPoint:
        """Return a reference point (3,) whose displacement can be read in any state; d solves."""
        where = np.asarray(place, dtype=float)
        model, d = self._model, self.scene.dimension
        rows = model.sampling(plane_points(where, d)).toarray()
        response = np.stack([expand(model, self._factor.solve(row)) for row in rows])
        return MaterialPoint(where, response)

    def position_of(self, point: MaterialPoint) -> Vector:
        """Return where a material point is now, tissue frame, (3,), m."""
        table, forces = self.observe().loaded()
        if table.count == 0:
            return point.place
        loads = table.loads(forces)
        moved = np.einsum("akb,kb->a", point.response[:, table.rows.nodes], loads)
        if len(moved) == 2:
            moved = np.array([moved[0], 0.0, moved[1]])
        return np.asarray(point.place + moved)

    @property
    def inserted(self) -> float:
        """Length of the needle in the tissue, m."""
        contact = self._state.contact
        return float(contact.depth) if contact.inserted else 0.0

    @property
    def track_points(self) -> Vector:
        """Reference positions of the track up to the tip, (k, 3), m: material points."""
        contact = self._state.contact
        if contact.track is None or not contact.inserted:
            return np.zeros((0, 3))
        inside = contact.track.points[: int(contact.depth / contact.track.spacing) + 1]
        points = np.vstack([inside, contact.track.at(contact.depth)])
        if points.shape[1] == 3:
            return points
        return np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]])

    def changed(self, changes: Mapping[str, object]) -> QuickSimulator:
        """Return a simulator of a changed scene on the same factorised tissue, at its start.

        Needle, tip and laws may change freely; of the tissue only its Young's modulus, as a
        similar scene. Forces then count in another unit: ``force_scale``.

        Raises
        ------
        NeedleSimError
            For keys that would need another factorisation, or where regions have moduli of
            their own.
        """
        rest = dict(changes)
        modulus = rest.pop("tissue.youngs_modulus", None)
        for key in rest:
            if key.startswith(_FIXED):
                raise NeedleSimError(f"{key}: cannot change without preparing the tissue again")
        scene = self.scene.with_changes(rest) if rest else self.scene
        scale = self.force_scale
        if modulus is not None:
            if any(region.youngs_modulus is not None for region in scene.tissue.regions):
                raise NeedleSimError("tissue.youngs_modulus: regions have moduli of their own")
            if not (isinstance(modulus, (int, float)) and modulus > 0):
                raise SceneError("tissue.youngs_modulus", modulus, "must be > 0, in Pa")
            scale = float(modulus) / scene.tissue.youngs_modulus
            scene = softened(scene, scale, self.scene)
        twin = self.variant(scene)
        assert isinstance(twin, QuickSimulator)
        twin.force_scale = scale
        return twin
