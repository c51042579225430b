# SPDX-License-Identifier: Apache-2.0
"""Material of the tissue at points: homogeneous, or by regions of which the last wins."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Region, Scene, Tissue
from needle_sim_ros.tissue.elements import Material
from needle_sim_ros.tissue.mesh_file import read_tetrahedra

T = TypeVar("T", float, Vector)


def lame_parameters(youngs_modulus: T, poisson_ratio: T, plane: str | None) -> tuple[T, T]:
    """Return lambda and mu, Pa; `plane` is strain, stress, or None in 3D."""
    shear = youngs_modulus / (2 * (1 + poisson_ratio))
    lame = youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    if plane == "stress":
        lame = 2 * shear * lame / (lame + 2 * shear)
    return lame, shear


def inside(region: Region, points: Vector) -> NDArray[np.bool_]:
    """Tell which points, shape (3, ...), lie in a region."""
    offset = points - np.reshape(region.center, (3, *(1,) * (points.ndim - 1)))
    if region.shape == "half_space":
        return np.asarray(np.tensordot(np.array(region.axis), offset, 1) <= 0)
    if region.shape == "cylinder":
        axis = np.array(region.axis) / np.linalg.norm(region.axis)
        along = np.tensordot(axis, offset, 1)
        across2 = (offset**2).sum(axis=0) - along**2
        radius = region.size[0] / 2
        return np.asarray((np.abs(along) <= region.size[2] / 2) & (across2 <= radius**2))
    half = np.reshape(np.array(region.size) / 2, (3, *(1,) * (points.ndim - 1)))
    if region.shape == "box":
        return np.asarray((np.abs(offset) <= half).all(axis=0))
    return np.asarray(((offset / half) ** 2).sum(axis=0) <= 1)


def in_region(scene: Scene, region: Region, points: Vector) -> NDArray[np.bool_]:
    """Tell which points, shape (3, ...), lie in a region of a scene, which may be tagged cells."""
    if region.shape == "tag":
        return read_tetrahedra(scene).tagged(region.name, points)
    return inside(region, points)


def in_space(points: Vector) -> Vector:
    """Put points of the plane, shape (2, ...), into the world, shape (3, ...), with y = 0."""
    if len(points) == 3:
        return points
    return np.array([points[0], np.zeros_like(points[0]), points[1]])


class MaterialField:
    """The material of a tissue at any point.

    Parameters
    ----------
    scene : Scene
        Its tissue, regions and dimension are used.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._tissue: Tissue = scene.tissue
        self._plane = scene.tissue.plane if scene.dimension == 2 else None

    def __call__(self, points: Vector) -> Material:
        """Return the material at points, shape (d, ...)."""
        tissue = self._tissue
        shape = points.shape[1:]
        modulus = np.full(shape, tissue.youngs_modulus)
        ratio = np.full(shape, tissue.poisson_ratio)
        density = np.full(shape, tissue.density)
        world = in_space(points)
        for region in tissue.regions:
            mask = in_region(self._scene, region, world)
            for values, own in (
                (modulus, region.youngs_modulus),
                (ratio, region.poisson_ratio),
                (density, region.density),
            ):
                if own is not None:
                    values[mask] = own
        lame, shear = lame_parameters(modulus, ratio, self._plane)
        return Material(lame, shear, density)
