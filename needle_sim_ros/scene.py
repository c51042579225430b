# SPDX-License-Identifier: Apache-2.0
"""What to simulate: typed, validated, immutable; YAML in and out.

SI units. Tissue frame: origin at the nominal contact point on the top surface, +z out
of the tissue, the tissue at z <= 0. A 2D scene is the plane y = 0 of the same world.
Needle base frame: origin at the clamp, +z along the undeflected needle, x the
deflection direction of 2D scenes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import yaml

from needle_sim_ros import scene_checks
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import SceneError
from needle_sim_ros.resources import find_scene
from needle_sim_ros.schema import build, plain, quantity

Face = Literal["left", "right", "front", "back", "bottom", "top"]
_LARGEST_FILE = 1_000_000


@dataclass(frozen=True)
class Damping:
    """Rayleigh damping C = alpha M + beta K."""

    alpha: float = quantity(0.0, unit="1/s", ge=0)
    beta: float = quantity(0.0, unit="s", ge=0)


@dataclass(frozen=True)
class Mesh:
    """Tissue mesh, graded to the needle's planned path; null means chosen from the needle.

    `element` null is quad2 in 2D and quad1 in 3D, where they are hexahedra.

    `file` (3D only) takes tetrahedra from a file that meshio reads, as quadratic ones (tri2);
    the keys of the graded mesh mean nothing then. Its coordinates times `scale` are metres;
    `offset` moves them into the tissue frame, null moves them up or down so that the
    surface is at z = 0 where the needle enters. `fixed` names faces (physical groups, cell
    sets, tags), `fixed_boxes` holds the faces that lie within x from, to, y from, to, z
    from, to, of the tissue frame.
    """

    element: Literal["quad2", "quad1", "tri2", "tri1"] | None = None
    spacing_across: float | None = quantity(None, unit="m", gt=0)
    spacing_along: float | None = quantity(None, unit="m", gt=0)
    growth: float = quantity(1.5, gt=1, le=4)
    largest: float | None = quantity(None, unit="m", gt=0)
    band: float | None = quantity(None, unit="m", gt=0)
    uniform: bool = False
    file: str | None = None
    scale: float = quantity(1.0, unit="m", gt=0)
    offset: tuple[float, ...] | None = quantity(None, unit="m", length=(3,))
    fixed: tuple[str, ...] = ()
    fixed_boxes: tuple[tuple[float, ...], ...] = quantity((), unit="m")


@dataclass(frozen=True)
class Region:
    """A part of the tissue with properties of its own; later regions win.

    `half_space` is everything below `center` against the direction `axis`; `box` and
    `ellipsoid` have edge lengths and axes `size`; `cylinder` has the axis `axis`, and
    `size` is diameter, diameter, length; `tag` is the cells of a mesh file that are named,
    or numbered, as `name` is. null keeps the property of the tissue.
    """

    name: str
    shape: Literal["box", "ellipsoid", "cylinder", "half_space", "tag"]
    center: tuple[float, ...] = quantity((0.0, 0.0, 0.0), unit="m", length=(3,))
    size: tuple[float, ...] = quantity((1.0, 1.0, 1.0), unit="m", gt=0, length=(3,))
    axis: tuple[float, ...] = quantity((0.0, 0.0, 1.0), length=(3,))
    youngs_modulus: float | None = quantity(None, unit="Pa", gt=0)
    poisson_ratio: float | None = quantity(None, ge=0, lt=0.5)
    density: float | None = quantity(None, unit="kg/m^3", gt=0)
    friction_static: float | None = quantity(None, unit="N/m", ge=0)
    friction_kinetic: float | None = quantity(None, unit="N/m", ge=0)
    cutting_force: float | None = quantity(None, unit="N", ge=0)
    puncture_force: float | None = quantity(None, unit="N", ge=0)


@dataclass(frozen=True)
class Tissue:
    """Linear-elastic block, u = 0 on the fixed faces, on `rollers` only normal to the face.

    `size` is width x, depth z in 2D and x, y, z in 3D, of the box that holds it where the
    mesh is from a file; `thickness` is out of plane (2D).
    """

    size: tuple[float, ...] = quantity(unit="m", gt=0, length=(2, 3))
    youngs_modulus: float = quantity(unit="Pa", gt=0)
    poisson_ratio: float = quantity(ge=0, lt=0.5)
    density: float = quantity(1000.0, unit="kg/m^3", gt=0)
    thickness: float = quantity(0.024, unit="m", gt=0)
    plane: Literal["strain", "stress"] = "strain"
    damping: Damping = field(default_factory=Damping)
    fixed: tuple[Face, ...] | None = None
    rollers: tuple[Face, ...] = ()
    regions: tuple[Region, ...] = ()
    mesh: Mesh = field(default_factory=Mesh)


@dataclass(frozen=True)
class Tip:
    """Bevel: angle of the face to the axis, angle at which it deviates when cutting, roll.

    A positive deviation at roll 0 steers towards +x of the base frame.
    """

    bevel_angle: float = quantity(math.pi / 4, unit="rad", gt=0, le=math.pi / 2)
    deviation_angle: float = quantity(0.0, unit="rad", ge=-0.7, le=0.7)
    roll: float = quantity(0.0, unit="rad")


@dataclass(frozen=True)
class Needle:
    """Solid or hollow cantilever; `second_moment` null means that of the solid circle."""

    length: float = quantity(unit="m", gt=0)
    radius: float = quantity(unit="m", gt=0)
    youngs_modulus: float = quantity(unit="Pa", gt=0)
    second_moment: float | None = quantity(None, unit="m^4", gt=0)
    tip: Tip = field(default_factory=Tip)

    @cached_property
    def flexural_rigidity(self) -> float:
        """E I, N m^2."""
        solid = math.pi * self.radius**4 / 4
        return self.youngs_modulus * (self.second_moment or solid)


@dataclass(frozen=True)
class Friction:
    """Friction per inserted length.

    Falls from static to kinetic over the weakening distance of slip, and comes back with the
    healing time where a point rests.
    """

    static: float = quantity(0.0, unit="N/m", ge=0)
    kinetic: float = quantity(0.0, unit="N/m", ge=0)
    presliding_stiffness: float = quantity(1e9, unit="N/m per m", gt=0)
    weakening_distance: float = quantity(5e-4, unit="m", gt=0)
    healing_time: float = quantity(0.1, unit="s", gt=0)


@dataclass(frozen=True)
class Ripple:
    """Periodic part of the cutting force over depth: relative amplitude, wavelength."""

    amplitude: float = quantity(0.0, ge=0, le=1)
    wavelength: float = quantity(1e-3, unit="m", gt=0)


@dataclass(frozen=True)
class Cutting:
    """Axial force at which the tip cuts, and how it relaxes in a hold."""

    force: float = quantity(0.0, unit="N", ge=0)
    relaxation_time: float = quantity(1.0, unit="s", gt=0)
    ripple: Ripple = field(default_factory=Ripple)


@dataclass(frozen=True)
class Puncture:
    """Axial force at which the surface breaks; null means the cutting force."""

    force: float | None = quantity(None, unit="N", ge=0)


@dataclass(frozen=True)
class Interaction:
    """The laws between needle and tissue."""

    friction: Friction = field(default_factory=Friction)
    cutting: Cutting = field(default_factory=Cutting)
    puncture: Puncture = field(default_factory=Puncture)


@dataclass(frozen=True)
class Newmark:
    """Newmark's parameters: the paper's delta and xi."""

    delta: float = quantity(0.5, ge=0.5, le=1)
    xi: float = quantity(0.25, gt=0, le=1)


@dataclass(frozen=True)
class Solver:
    """How to solve.

    `time_step` is the tick of `needle_sim run` and, with Newmark, the step of the
    effective matrix. `modes` (Newmark only): 0 keeps every unknown; a number keeps that
    many lowest modes dynamic and the rest by their massless response. `factorization` is
    the library that factorises the tissue's matrix; auto takes the fastest installed in 3D.
    """

    dynamics: Literal["quasi_static", "newmark"] = "quasi_static"
    time_step: float = quantity(0.01, unit="s", ge=1e-5, le=10)
    track_spacing: float = quantity(1e-3, unit="m", gt=0)
    newmark: Newmark = field(default_factory=Newmark)
    modes: int = quantity(0, ge=0, le=2000)
    tolerance: float = quantity(1e-10, gt=0, le=1e-4)
    factorization: Literal["auto", "superlu", "pardiso"] = "auto"


@dataclass(frozen=True)
class Base:
    """Pose of the needle base at the start; the default points down, 10 mm above."""

    position: tuple[float, ...] | None = quantity(None, unit="m", length=(3,))
    orientation: tuple[float, ...] = quantity((1.0, 0.0, 0.0, 0.0), length=(4,))


@dataclass(frozen=True)
class Segment:
    """A stretch of the protocol: a twist in the tissue frame held for a duration."""

    duration: float = quantity(unit="s", gt=0, le=1e5)
    velocity: tuple[float, ...] = quantity((0.0, 0.0, 0.0), unit="m/s", length=(3,))
    angular_velocity: tuple[float, ...] = quantity((0.0, 0.0, 0.0), unit="rad/s", length=(3,))

    def command(self) -> BaseCommand:
        """Return the base command of each tick of this segment."""
        return BaseCommand(velocity=self.velocity, angular_velocity=self.angular_velocity)


@dataclass(frozen=True)
class Scene:
    """Everything a simulation starts from; validated when made.

    Raises
    ------
    SceneError
        Naming the dotted key, the value and what is allowed.
    """

    name: str
    tissue: Tissue
    needle: Needle
    dimension: Literal[2, 3] = 2
    interaction: Interaction = field(default_factory=Interaction)
    markers: tuple[tuple[float, ...], ...] = quantity((), unit="m")
    solver: Solver = field(default_factory=Solver)
    base: Base = field(default_factory=Base)
    protocol: tuple[Segment, ...] = ()

    def __post_init__(self) -> None:
        if self.base.position is None:
            above = (0.0, 0.0, self.needle.length + 0.01)
            object.__setattr__(self, "base", Base(above, self.base.orientation))
        if self.tissue.fixed is None:
            sides: tuple[Face, ...] = ("left", "right", "bottom") + (
                ("front", "back") if self.dimension == 3 else ()
            )
            free = tuple(face for face in sides if face not in self.tissue.rollers)
            if self.tissue.mesh.file is not None:
                free = ()
            object.__setattr__(self, "tissue", replace(self.tissue, fixed=free))
        if self.tissue.mesh.element is None:
            element: Literal["quad2", "quad1", "tri2"]
            element = "quad2" if self.dimension == 2 else "quad1"
            if self.tissue.mesh.file is not None:
                element = "tri2"
            mesh = replace(self.tissue.mesh, element=element)
            object.__setattr__(self, "tissue", replace(self.tissue, mesh=mesh))
        if self.interaction.puncture.force is None:
            broken = Puncture(self.interaction.cutting.force)
            changed = replace(self.interaction, puncture=broken)
            object.__setattr__(self, "interaction", changed)
        scene_checks.check(self)

    @classmethod
    def load(cls, source: str | Path, overrides: Mapping[str, object] | None = None) -> Scene:
        """Load a YAML file, or a scene of this package by its bare name.

        Parameters
        ----------
        source : path or str
            A file, or a bare name such as ``gao2016``.
        overrides : mapping, optional
            Dotted keys to values, e.g. ``{"solver.dynamics": "quasi_static"}``.
        """
        path = find_scene(source)
        try:
            if path.stat().st_size > _LARGEST_FILE:
                raise SceneError("scene", str(path), f"larger than {_LARGEST_FILE} bytes")
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise SceneError("scene", str(path), f"cannot be read: {error}") from None
        return cls.from_yaml(text, overrides, folder=path.parent)

    @classmethod
    def from_yaml(
        cls,
        text: str,
        overrides: Mapping[str, object] | None = None,
        folder: Path | None = None,
    ) -> Scene:
        """Build a scene from YAML text; a mesh file may be named relative to a folder."""
        try:
            data = yaml.safe_load(text)
        except (yaml.YAMLError, RecursionError) as error:
            words = " ".join(str(error).split())
            raise SceneError("scene", text[:40], f"not valid YAML: {words}") from None
        scene = cls.from_dict(data, overrides)
        file = scene.tissue.mesh.file
        if folder is None or file is None or not (folder / file).is_file():
            return scene
        return scene.with_changes({"tissue.mesh.file": str((folder / file).resolve())})

    @classmethod
    def from_dict(cls, data: object, overrides: Mapping[str, object] | None = None) -> Scene:
        """Build a scene from nested mappings, with dotted `overrides` laid over them."""
        for key, value in (overrides or {}).items():
            data = _overlaid(data, key.split("."), value, key)
        return build(cls, data)

    def to_dict(self) -> dict[str, Any]:
        """Return nested mappings that :meth:`from_dict` turns into an equal scene."""
        mapping: dict[str, Any] = plain(self)
        return mapping

    def to_yaml(self) -> str:
        """Return YAML text that :meth:`from_yaml` turns into an equal scene."""
        text: str = yaml.safe_dump(self.to_dict(), sort_keys=False, default_flow_style=None)
        return text

    def with_changes(self, overrides: Mapping[str, object]) -> Scene:
        """Return a scene with dotted keys changed, validated again."""
        return Scene.from_dict(self.to_dict(), overrides)


def _overlaid(data: Any, path: list[str], value: object, key: str) -> Any:
    if not path:
        return value
    name, rest = path[0], path[1:]
    if isinstance(data, (list, tuple)):
        try:
            index = int(name)
            entries: Iterable[Any] = [
                _overlaid(v, rest, value, key) if i == index else v for i, v in enumerate(data)
            ]
            if not 0 <= index < len(data):
                raise ValueError
        except ValueError:
            allowed = f"entry {name!r} does not exist; 0 to {len(data) - 1} do"
            raise SceneError(key, value, allowed) from None
        return list(entries)
    if data is None:
        data = {}
    if not isinstance(data, Mapping):
        raise SceneError(key, value, f"unknown key; {name!r} lies below a plain value")
    return {**data, name: _overlaid(data.get(name), rest, value, key)}
