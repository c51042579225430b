# SPDX-License-Identifier: Apache-2.0
"""Tissue out of a file of tetrahedra: read through meshio, placed under the needle, checked."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from needle_sim_ros.errors import SceneError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.resources import find_mesh
from needle_sim_ros.scene import Mesh, Scene
from needle_sim_ros.scene_checks import half_widths
from needle_sim_ros.tissue.mesh import Index, planned_path
from needle_sim_ros.tissue.tetrahedra import Tetrahedra

_KEY = "tissue.mesh.file"
_TAGS = ("gmsh:physical", "medit:ref", "cell_tags", "region", "material")


_latest: list[tuple[Scene, Tetrahedra]] = []


def read_tetrahedra(scene: Scene) -> Tetrahedra:
    """Read the tissue of a scene from its file.

    Raises
    ------
    SceneError
        Where file and scene do not fit, saying what and where.
    """
    for known, found in _latest:  # asked for in every tick: to compare scenes would take long
        if known is scene:
            return found
    assert scene.tissue.mesh.file is not None
    path = find_mesh(scene.tissue.mesh.file)
    entry = planned_path(scene).entry
    stamp = path.stat().st_mtime_ns
    found = _read(path, stamp, scene.tissue.mesh, float(entry[0]), float(entry[1]))
    _check_extent(scene, found)
    _check_regions(scene, found)
    _check_spacing(scene, found)
    _latest[:] = [(scene, found), *_latest[:3]]
    return found


@lru_cache(maxsize=4)
def _read(path: Path, stamp: int, wanted: Mesh, x: float, y: float) -> Tetrahedra:
    try:
        import meshio
    except ImportError:
        raise SceneError(_KEY, str(path), "needs meshio: pip install meshio") from None
    try:
        data = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio leaves by what its parsers raise
        words = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(_KEY, str(path), f"meshio cannot read it: {words}") from None
    points = np.asarray(data.points, dtype=float) * wanted.scale
    cells = _corners(data, "tetra", 4)
    if points.shape[1] != 3 or not len(cells):
        raise SceneError(_KEY, str(path), "holds no tetrahedra")
    if not np.isfinite(points).all():
        raise SceneError(_KEY, str(path), "has points that are not finite")
    used, cells = np.unique(cells, return_inverse=True)
    renumber = np.full(len(points), -1, dtype=np.intp)
    renumber[used] = np.arange(len(used))
    points, cells = points[used], cells.reshape(-1, 4)
    _check_cells(path, points, cells)
    faces = renumber[_corners(data, "triangle", 3)]
    if wanted.offset is not None:
        points = points + np.array(wanted.offset)
    mesh = skfem.MeshTet(points.T.copy(), np.ascontiguousarray(cells.T), sort_t=False)
    height, facet = _surface(path, mesh, x, y)
    if wanted.offset is None:
        mesh = skfem.MeshTet(
            (points - [0.0, 0.0, height]).T.copy(), np.ascontiguousarray(cells.T), sort_t=False
        )
    elif abs(height) > 1e-6 * float(np.ptp(points[:, 2])):
        better = [*wanted.offset[:2], wanted.offset[2] - height]
        raise SceneError(
            "tissue.mesh.offset",
            list(wanted.offset),
            f"the surface where the needle enters is at z = {height:g} and must be at 0: {better}",
        )
    fixed = _fixed(path, mesh, wanted, _named(data, "triangle"), faces)
    if facet in fixed:
        raise SceneError(
            "tissue.mesh.fixed",
            [*wanted.fixed, *map(list, wanted.fixed_boxes)],
            f"the needle enters through a fixed face, at x = {x:g}, y = {y:g}",
        )
    return Tetrahedra(mesh, _named(data, "tetra"), fixed)


def _corners(data: Any, kind: str, count: int) -> Index:
    blocks = [np.asarray(b.data)[:, :count] for b in data.cells if b.type.startswith(kind)]
    return np.concatenate([np.zeros((0, count), dtype=np.intp), *blocks]).astype(np.intp)


def _named(data: Any, kind: str) -> dict[str, NDArray[np.bool_]]:
    """Return which cells of a kind each name means: tags, names of tags, and sets."""
    blocks = [i for i, block in enumerate(data.cells) if block.type.startswith(kind)]
    if not blocks:
        return {}
    found: dict[str, NDArray[np.bool_]] = {}
    for name in _TAGS:
        if name in data.cell_data:
            tags = np.concatenate([np.asarray(data.cell_data[name][i]).ravel() for i in blocks])
            dimension = 3 if kind == "tetra" else 2
            for tag in np.unique(tags):
                found[f"{tag:g}"] = tags == tag
            for word, (tag, of) in data.field_data.items():
                if of == dimension:
                    found[str(word)] = tags == tag
    sizes = [len(data.cells[i].data) for i in blocks]
    for name, members in data.cell_sets.items():
        masks = []
        for i, size in zip(blocks, sizes, strict=True):
            mask = np.zeros(size, dtype=bool)
            if members[i] is not None:
                mask[np.asarray(members[i], dtype=np.intp)] = True
            masks.append(mask)
        if any(mask.any() for mask in masks):
            found[str(name)] = np.concatenate(masks)
    return found


def _check_cells(path: Path, points: Vector, cells: Index) -> None:
    """Refuse inverted and disconnected elements."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    volume = np.linalg.det(edges) / 6
    size = np.abs(edges).max(axis=(1, 2))
    bad = np.flatnonzero(volume <= 1e-9 * size**3)
    if len(bad):
        where = points[cells[bad[0]]].mean(axis=0)
        raise SceneError(
            _KEY,
            str(path),
            f"{len(bad)} tetrahedra are inverted or flat, the first is number {bad[0]} "
            f"about {_place(where)} of the file",
        )
    hub, rim = np.repeat(cells[:, 0], 3), cells[:, 1:].ravel()
    graph = coo_array((np.ones(len(hub)), (hub, rim)), shape=(len(points),) * 2)
    count, part = connected_components(graph, directed=False)
    if count > 1:
        small = int(np.bincount(part).argmin())
        where = points[part == small].mean(axis=0)
        raise SceneError(
            _KEY,
            str(path),
            f"falls into {count} parts that do not touch, the smallest about {_place(where)}"
            " of the file",
        )


def _place(where: Vector) -> str:
    return "x = {:g}, y = {:g}, z = {:g} m".format(*where)


def _surface(path: Path, mesh: skfem.MeshTet, x: float, y: float) -> tuple[float, int]:
    """Return the greatest height of the surface at x, y and the facet there."""
    facets = np.asarray(mesh.boundary_facets(), dtype=np.intp)
    a, b, c = np.moveaxis(mesh.p[:, mesh.facets[:, facets]], 1, 0)
    first, second, to = b - a, c - a, np.array([[x], [y]]) - a[:2]
    area = first[0] * second[1] - first[1] * second[0]
    steep = np.abs(area) < 1e-12 * (np.abs(first).max(axis=0) * np.abs(second).max(axis=0))
    area = np.where(steep, np.inf, area)
    u = (to[0] * second[1] - to[1] * second[0]) / area
    v = (first[0] * to[1] - first[1] * to[0]) / area
    over = ~steep & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    if not over.any():
        raise SceneError(
            _KEY, str(path), f"the needle at x = {x:g}, y = {y:g} would pass beside the tissue"
        )
    height = np.where(over, a[2] + u * first[2] + v * second[2], -np.inf)
    return float(height.max()), int(facets[height.argmax()])


def _fixed(
    path: Path,
    mesh: skfem.MeshTet,
    wanted: Mesh,
    named: dict[str, NDArray[np.bool_]],
    faces: Index,
) -> Index:
    """Return the held facets: those of the named triangles, those within the boxes."""
    surface = np.asarray(mesh.boundary_facets(), dtype=np.intp)
    held = np.zeros(mesh.facets.shape[1], dtype=bool)
    number = {tuple(sorted(mesh.facets[:, i].tolist())): i for i in surface}
    for name in wanted.fixed:
        if name not in named:
            words = ", ".join(sorted(named)) or "none"
            raise SceneError("tissue.mesh.fixed", name, f"no faces of {path} are so named: {words}")
        found = [number.get(tuple(sorted(face))) for face in faces[named[name]].tolist()]
        held[[i for i in found if i is not None]] = True
    corners = mesh.p[:, mesh.facets[:, surface]]
    for box in wanted.fixed_boxes:
        low, high = np.array(box[::2]), np.array(box[1::2])
        within = (corners >= low[:, None, None]) & (corners <= high[:, None, None])
        held[surface[within.all(axis=(0, 1))]] = True
    if not held.any():
        raise SceneError(
            "tissue.mesh.fixed",
            [*wanted.fixed, *map(list, wanted.fixed_boxes)],
            "holds no face of the surface, and the tissue would float",
        )
    return np.flatnonzero(held)


def _check_extent(scene: Scene, found: Tetrahedra) -> None:
    half_x, half_y, depth = half_widths(scene)
    low, high = found.mesh.p.min(axis=1), found.mesh.p.max(axis=1)
    reach = np.maximum(np.abs(low), np.abs(high))
    slack = 1e-6 * max(scene.tissue.size)
    if (reach[:2] > np.array([half_x, half_y]) + slack).any() or low[2] < -depth - slack:
        raise SceneError(
            "tissue.size",
            list(scene.tissue.size),
            f"must hold the mesh, at least [{2 * reach[0]:.6g}, {2 * reach[1]:.6g}, {-low[2]:.6g}]",
        )


def _check_regions(scene: Scene, found: Tetrahedra) -> None:
    for index, region in enumerate(scene.tissue.regions):
        if region.shape == "tag" and region.name not in found.tags:
            words = ", ".join(sorted(found.tags)) or "none"
            raise SceneError(
                f"tissue.regions[{index}].name",
                region.name,
                f"no cells of {scene.tissue.mesh.file} are so tagged: {words}",
            )
        if region.shape != "tag":
            from needle_sim_ros.tissue.material import inside

            middles = found.mesh.p[:, found.mesh.t].mean(axis=1)
            if not inside(region, middles).any():
                raise SceneError(
                    f"tissue.regions[{index}].center",
                    list(region.center),
                    "the region holds no element of the mesh",
                )


def _check_spacing(scene: Scene, found: Tetrahedra) -> None:
    """Refuse a track finer than the nodes along it: it over-constrains the tissue."""
    path, spacing = planned_path(scene), scene.solver.track_spacing
    depths = np.arange(0.0, path.depth, spacing)[:, None]
    cells, _, inside = found.locate(path.entry + depths * path.direction)
    p = found.mesh.p[:, found.mesh.t[:, np.unique(cells[inside])]]
    pairs = [(i, j) for i in range(4) for j in range(i)]
    edges = np.array([np.linalg.norm(p[:, i] - p[:, j], axis=0) for i, j in pairs])
    nodes = float(edges.mean()) / 2
    if spacing < 0.8 * nodes:
        raise SceneError(
            "solver.track_spacing",
            spacing,
            f"must be >= {0.8 * nodes:.3g}: along the path the mesh's nodes are {nodes:.3g} m"
            " apart, and a finer track over-constrains the tissue",
        )
