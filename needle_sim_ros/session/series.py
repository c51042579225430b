# SPDX-License-Identifier: Apache-2.0
"""A run as arrays over time: what plots, comparisons and identification work on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.errors import SessionError

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.scene import Scene

Array = NDArray[np.float64]

_WIDTH_3 = ("base_force", "base_torque", "tip_position", "tip_deflection", "base_position")
_SCALAR = ("insertion_depth", "friction_force", "tip_force")


@dataclass(frozen=True, eq=False)
class Series:
    """Observations of n ticks as arrays.

    Parameters
    ----------
    time : (n,) array
        Simulated time, s.
    insertion_depth : (n,) array
        m.
    base_force, base_torque : (n, 3) arrays
        What the tissue does to the needle, at the base, base frame; N, N m.
    tip_position : (n, 3) array
        Tissue frame, m.
    tip_deflection : (n, 3) array
        Base frame, m.
    process : list of str
        ``free``, ``contact``, ``insertion``, ``hold`` or ``retraction``, one per tick.
    marker_reference : (m, 3) array
        Markers in the undeformed tissue, m.
    marker_displacements : (n, m, 3) array
        m.
    friction_force, tip_force : (n,) arrays, optional
        Axial, on the tissue, N.
    base_position : (n, 3) array, optional
        Tissue frame, m.
    base_orientation : (n, 4) array, optional
        Quaternion x y z w, base to tissue frame.
    tip_orientation : (n, 4) array, optional
        Quaternion x y z w; +z along the deflected needle at its tip.
    scene_text : str
        The scene as YAML; empty when unknown.
    metadata : mapping of str to str
        What the session says about itself.

    Raises
    ------
    SessionError
        When shapes disagree.
    """

    time: Array
    insertion_depth: Array
    base_force: Array
    base_torque: Array
    tip_position: Array
    tip_deflection: Array
    process: list[str]
    marker_reference: Array
    marker_displacements: Array
    friction_force: Array | None = None
    tip_force: Array | None = None
    base_position: Array | None = None
    base_orientation: Array | None = None
    tip_orientation: Array | None = None
    scene_text: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, m = len(self.time), len(self.marker_reference)
        shapes: dict[str, tuple[int, ...]] = {"time": (n,)}
        shapes |= dict.fromkeys(("base_orientation", "tip_orientation"), (n, 4))
        shapes |= dict.fromkeys(_SCALAR, (n,)) | dict.fromkeys(_WIDTH_3, (n, 3))
        shapes |= {"marker_reference": (m, 3), "marker_displacements": (n, m, 3)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise SessionError(f"{name} has shape {array.shape}: must be {shape}")
        if len(self.process) != n:
            raise SessionError(f"process has {len(self.process)} entries: must be {n}")

    def __len__(self) -> int:
        return len(self.time)

    @property
    def marker_positions(self) -> Array:
        """Markers where they are, (n, m, 3), m."""
        positions: Array = self.marker_reference + self.marker_displacements
        return positions

    @classmethod
    def from_observations(
        cls,
        observations: Iterable[Observation],
        scene: Scene | None = None,
        metadata: Mapping[str, str] | None = None,
    ) -> Series:
        """Collect observations, which may come from a generator and are not kept.

        Parameters
        ----------
        observations : iterable of Observation
            In the order of time.
        scene : Scene, optional
            Gives the scene's text.
        metadata : mapping, optional
            Kept as it is.
        """
        names = (*_WIDTH_3, "base_orientation", "marker_displacements")
        vectors: dict[str, list[Array]] = {name: [] for name in names}
        scalars: dict[str, list[float]] = {name: [] for name in ("time", *_SCALAR)}
        process: list[str] = []
        reference: Array = np.zeros((0, 3))
        for observation in observations:
            if not process:
                displaced = observation.marker_positions - observation.marker_displacements
                reference = displaced.reshape(-1, 3)
            for name, values in vectors.items():
                values.append(np.array(getattr(observation, name), dtype=float))
            for name, numbers in scalars.items():
                numbers.append(float(getattr(observation, name)))
            process.append(observation.process.value)
        n = len(process)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_WIDTH_3, (3,))
        shapes |= {"base_orientation": (4,), "marker_displacements": (len(reference), 3)}
        arrays = {name: np.array(numbers, dtype=float) for name, numbers in scalars.items()}
        arrays |= {name: np.reshape(rows, (n, *shapes[name])) for name, rows in vectors.items()}
        return cls(
            **arrays,
            process=process,
            marker_reference=reference,
            scene_text="" if scene is None else scene.to_yaml(),
            metadata=dict(metadata or {}),
        )
