# SPDX-License-Identifier: Apache-2.0
"""What no single key can tell: checks of a scene across its keys."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.errors import SceneError
from needle_sim_ros.geometry import Vector, rotation_matrix, turn

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene

_STEEPEST = math.radians(75)
_SAMPLES = 20
# how much finer than the nodes in 3D a track may be
_FINER = 3.0


def check(scene: Scene) -> None:
    """Raise SceneError where the keys of `scene` do not fit each other."""
    _tissue(scene)
    _markers(scene)
    _interaction(scene)
    _solver(scene)
    _base(scene)
    _protocol(scene)


def half_widths(scene: Scene) -> tuple[float, float, float]:
    """Return the half width in x, the half width in y (0 in 2D) and the depth, m."""
    size = scene.tissue.size
    return size[0] / 2, (size[1] / 2 if scene.dimension == 3 else 0.0), size[-1]


def base_poses(scene: Scene) -> list[tuple[Vector, Vector]]:
    """Return sampled base positions and orientations along the protocol, the start first."""
    position = np.array(scene.base.position)
    quaternion = np.array(scene.base.orientation)
    quaternion = quaternion / np.linalg.norm(quaternion)
    poses = [(position, quaternion)]
    for segment in scene.protocol:
        for _ in range(_SAMPLES):
            part = segment.duration / _SAMPLES
            position = position + part * np.array(segment.velocity)
            quaternion = turn(quaternion, segment.angular_velocity, part)
            poses.append((position, quaternion))
    return poses


def _tissue(scene: Scene) -> None:
    tissue = scene.tissue
    if len(tissue.size) != scene.dimension:
        raise SceneError(
            "tissue.size", list(tissue.size), f"must have {scene.dimension} entries, as dimension"
        )
    assert tissue.fixed is not None
    if tissue.mesh.file is not None:
        _file(scene)
    elif not tissue.fixed:
        raise SceneError("tissue.fixed", [], "must name at least one face, or the tissue floats")
    if "top" in tissue.fixed:
        raise SceneError(
            "tissue.fixed", list(tissue.fixed), "the needle enters through the top: it must be free"
        )
    if scene.dimension == 2 and {"front", "back"} & set(tissue.fixed):
        raise SceneError(
            "tissue.fixed", list(tissue.fixed), "a 2D scene has the faces left, right, bottom, top"
        )
    _rollers(scene)
    from_file = tissue.mesh.file is not None
    if scene.dimension == 3 and str(tissue.mesh.element).startswith("tri") and not from_file:
        raise SceneError(
            "tissue.mesh.element", tissue.mesh.element, "must be quad1 or quad2 in 3D: hexahedra"
        )
    for index, region in enumerate(tissue.regions):
        if np.linalg.norm(region.axis) < 1e-9:
            raise SceneError(f"tissue.regions[{index}].axis", list(region.axis), "must not be zero")
        if region.shape == "tag":
            if not from_file:
                raise SceneError(
                    f"tissue.regions[{index}].shape", "tag", "needs a mesh file, tissue.mesh.file"
                )
        else:
            _region_inside(scene, index)
        static, kinetic = region.friction_static, region.friction_kinetic
        least = kinetic if kinetic is not None else scene.interaction.friction.kinetic
        greatest = static if static is not None else scene.interaction.friction.static
        if greatest < least:
            raise SceneError(
                f"tissue.regions[{index}].friction_static", static, f"must be >= kinetic, {least:g}"
            )


def _file(scene: Scene) -> None:
    tissue, mesh = scene.tissue, scene.tissue.mesh
    if scene.dimension != 3:
        raise SceneError("tissue.mesh.file", mesh.file, "tetrahedra need dimension 3")
    if mesh.element != "tri2":
        raise SceneError(
            "tissue.mesh.element", mesh.element, "must be tri2, quadratic, for a mesh file"
        )
    if tissue.fixed or tissue.rollers:
        raise SceneError(
            "tissue.fixed",
            [*(tissue.fixed or ()), *tissue.rollers],
            "faces of a block; a mesh file has tissue.mesh.fixed and tissue.mesh.fixed_boxes",
        )
    if not mesh.fixed and not mesh.fixed_boxes:
        raise SceneError("tissue.mesh.fixed", [], "must name a face, or the tissue floats")
    for index, box in enumerate(mesh.fixed_boxes):
        if len(box) != 6 or any(a > b for a, b in zip(box[::2], box[1::2], strict=True)):
            raise SceneError(
                f"tissue.mesh.fixed_boxes[{index}]",
                list(box),
                "must be x from, to, y from, to, z from, to",
            )


def _rollers(scene: Scene) -> None:
    tissue = scene.tissue
    rollers = list(tissue.rollers)
    if "top" in rollers:
        raise SceneError(
            "tissue.rollers", rollers, "the needle enters through the top: it must be free"
        )
    if set(rollers) & set(tissue.fixed or ()):
        raise SceneError("tissue.rollers", rollers, "must not name a face of tissue.fixed")
    if scene.dimension == 2 and {"front", "back"} & set(rollers):
        raise SceneError(
            "tissue.rollers", rollers, "a 2D scene has the faces left, right, bottom, top"
        )


def _region_inside(scene: Scene, index: int) -> None:
    region = scene.tissue.regions[index]
    half_x, half_y, depth = half_widths(scene)
    low = np.array([-half_x, -half_y, -depth])
    high = np.array([half_x, half_y, 0.0])
    center = np.array(region.center)
    reach = np.zeros(3) if region.shape == "half_space" else np.array(region.size) / 2
    if region.shape == "cylinder":
        reach = np.full(3, max(region.size[0], region.size[2]) / 2)
    if region.shape == "half_space":
        axis = np.array(region.axis)
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        outside = bool(((corners - center) @ axis >= 0).all())
    else:
        outside = bool((center + reach < low).any() or (center - reach > high).any())
    if outside:
        raise SceneError(
            f"tissue.regions[{index}].center", list(region.center), "the region lies outside"
        )


def _markers(scene: Scene) -> None:
    half_x, half_y, depth = half_widths(scene)
    for index, marker in enumerate(scene.markers):
        key = f"markers[{index}]"
        if len(marker) != 3:
            raise SceneError(key, list(marker), "must have 3 entries: x, y, z in m")
        x, y, z = marker
        if not (abs(x) <= half_x and abs(y) <= half_y and -depth <= z <= 0):
            raise SceneError(
                key,
                list(marker),
                f"must lie inside the tissue: |x| <= {half_x:g}, |y| <= {half_y:g}, "
                f"{-depth:g} <= z <= 0",
            )


def _interaction(scene: Scene) -> None:
    friction = scene.interaction.friction
    if friction.static < friction.kinetic:
        raise SceneError(
            "interaction.friction.static",
            friction.static,
            f"must be >= interaction.friction.kinetic, {friction.kinetic:g}",
        )
    puncture, cutting = scene.interaction.puncture.force, scene.interaction.cutting.force
    assert puncture is not None
    if puncture < cutting:
        raise SceneError(
            "interaction.puncture.force",
            puncture,
            f"must be >= interaction.cutting.force, {cutting:g}",
        )


def _solver(scene: Scene) -> None:
    solver, mesh = scene.solver, scene.tissue.mesh
    delta, xi = solver.newmark.delta, solver.newmark.xi
    if xi < 0.25 * (0.5 + delta) ** 2 - 1e-12:
        raise SceneError(
            "solver.newmark.xi",
            xi,
            f"must be >= 0.25 (0.5 + delta)^2 = {0.25 * (0.5 + delta) ** 2:g}, or it is unstable",
        )
    if solver.track_spacing > scene.needle.length / 4:
        raise SceneError(
            "solver.track_spacing",
            solver.track_spacing,
            f"must be <= a quarter of needle.length, {scene.needle.length / 4:g}",
        )
    along = mesh.spacing_along
    nodes = 2 if str(mesh.element).endswith("2") else 1
    finest = (along or 0.0) / nodes
    wide = (mesh.spacing_across or 0.0) / nodes
    if scene.dimension == 3 and mesh.file is None and wide > scene.needle.radius:
        # what the nodes do not show about the needle is added in closed form
        finest = finest / _FINER if wide >= finest else finest
    if solver.track_spacing < finest * (1 - 1e-9):
        raise SceneError(
            "solver.track_spacing",
            solver.track_spacing,
            f"must be >= {finest:g}, the node spacing that tissue.mesh.spacing_along gives: "
            "a track finer than the nodes over-constrains the tissue",
        )
    smallest = min(scene.tissue.size)
    if 2 * scene.needle.radius > smallest / 4:
        raise SceneError(
            "needle.radius",
            scene.needle.radius,
            f"must be <= {smallest / 8:g}, an eighth of the tissue's smallest size",
        )


def _base(scene: Scene) -> None:
    quaternion = np.array(scene.base.orientation)
    norm = float(np.linalg.norm(quaternion))
    if norm < 1e-6:
        raise SceneError(
            "base.orientation", list(scene.base.orientation), "must not be a zero quaternion"
        )
    axis = rotation_matrix(quaternion / norm)[:, 2]
    if -axis[2] < math.cos(_STEEPEST):
        raise SceneError(
            "base.orientation",
            list(scene.base.orientation),
            "the needle (+z of the base) must point into the tissue, at most 75 deg from -z",
        )
    assert scene.base.position is not None
    position = np.array(scene.base.position)
    if scene.dimension == 2:
        rotation = rotation_matrix(quaternion / norm)
        if abs(axis[1]) > 1e-9 or abs(rotation[1, 0]) > 1e-9:
            raise SceneError(
                "base.orientation",
                list(scene.base.orientation),
                "a 2D needle and its deflection stay in the plane y = 0",
            )
        if abs(position[1]) > 1e-12:
            raise SceneError("base.position", position.tolist(), "a 2D scene has y = 0")
    tip = position + scene.needle.length * axis
    if tip[2] < 0:
        raise SceneError(
            "base.position",
            position.tolist(),
            f"the tip must start above the surface, it would be at z = {tip[2]:g}",
        )


def _protocol(scene: Scene) -> None:
    if scene.dimension == 2:
        for index, segment in enumerate(scene.protocol):
            vx, vy, vz = segment.velocity
            wx, wy, wz = segment.angular_velocity
            if vy or wx or wz:
                raise SceneError(
                    f"protocol[{index}]",
                    {"velocity": [vx, vy, vz], "angular_velocity": [wx, wy, wz]},
                    "a 2D scene moves in x and z and turns about y only",
                )
    length = scene.needle.length
    worst = -math.inf
    for position, quaternion in base_poses(scene):
        axis = rotation_matrix(quaternion)[:, 2]
        if -axis[2] < 1e-3:
            raise SceneError("protocol", len(scene.protocol), "turns the needle out of the tissue")
        reach = float(position[2] / -axis[2])
        worst = max(worst, length - reach)
    if worst >= length:
        raise SceneError(
            "needle.length",
            length,
            f"must be longer than the insertion, which the protocol drives to {worst:g} m",
        )
    if worst < 0 and any(any(segment.velocity) for segment in scene.protocol):
        raise SceneError(
            "needle.length",
            length,
            f"too short for the protocol: the tip stays {-worst:g} m above the tissue",
        )
