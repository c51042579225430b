# SPDX-License-Identifier: Apache-2.0
"""The paper's algorithm as printed: the baseline of the benchmarks.

Gao, Lei, Lian and Yao (2016), DOI 10.1115/1.4034134, sections 2 to 4. Linear triangles on a
uniform grid, point forces, needle nodes where the needle crosses element edges; in every
iteration the needle's stiffness is added to the tissue's, the sum factorised and solved. What
is wrong in it is kept: Eq. (6), locking, point forces. Where the paper is silent (how a bevel
turns the track), the rule of the simulator is used, so that only the method differs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.benchmark.paper_mesh import Crossing
from needle_sim_ros.benchmark.paper_needle import printed_flexibility, printed_tip_slope
from needle_sim_ros.benchmark.paper_tissue import Coupling, PaperTissue
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import CommandError
from needle_sim_ros.geometry import rotation_matrix, turn
from needle_sim_ros.interaction.process import Process, classify
from needle_sim_ros.scene import Scene

Array = NDArray[np.float64]

PAPER_NODES = 1061
_PLANE = [0, 2]


@dataclass(frozen=True)
class PaperState:
    """What one iteration gives; names, frames and signs as those of ``Observation``.

    Attributes
    ----------
    time : float
        s.
    process : Process
    insertion_depth, friction_force, tip_force : float
        m, N, N; the forces axial, on the tissue, towards the tip.
    tip_deflection, base_force : ndarray, shape (3,)
        m, N; base frame.
    marker_displacements : ndarray, shape (n, 3)
        m, tissue frame.
    needle_nodes : int
        How many nodes the needle has, the paper's n.
    """

    time: float
    process: Process
    insertion_depth: float
    friction_force: float
    tip_force: float
    tip_deflection: Array
    base_force: Array
    marker_displacements: Array
    needle_nodes: int


@dataclass(frozen=True)
class _Contact:
    """Of one iteration: forces on the tissue, axial towards the tip, lateral along +x, N."""

    friction: float = 0.0
    tip: float = 0.0
    lateral: float = 0.0
    deflection: float = 0.0


class PaperSimulator:
    """The paper's model of a 2D scene of homogeneous tissue.

    Parameters
    ----------
    scene : Scene
        Two-dimensional, without regions. Quasi-static scenes leave the inertia out.
    nodes : int
        About how many tissue nodes.

    Raises
    ------
    SceneError
        On scenes that the paper's algorithm does not cover.
    """

    def __init__(self, scene: Scene, nodes: int = PAPER_NODES) -> None:
        self.scene = scene
        self.tissue = PaperTissue(scene, nodes)
        self._markers = np.array(scene.markers, dtype=float).reshape(-1, 3)[:, _PLANE]
        self.reset()

    def reset(self) -> None:
        """Return to the start of the scene."""
        self.time = 0.0
        self.position = np.array(self.scene.base.position, dtype=float)
        self.orientation = np.array(self.scene.base.orientation, dtype=float)
        self.tissue.rest()
        self._withdraw()

    def _withdraw(self) -> None:
        # The track: needle nodes, and the tip as a material point with the track's direction.
        self._nodes: list[Crossing] = []
        self._depth = 0.0
        self._tip = np.zeros(2)
        self._heading = np.zeros(2)
        self._sense = 1.0
        self._cutting = 0.0

    def step(self, command: BaseCommand, dt: float) -> PaperState:
        """Move the base and do one iteration.

        Parameters
        ----------
        command : BaseCommand
        dt : float
            s; with Newmark the scene's ``solver.time_step``.

        Raises
        ------
        CommandError
            On another time step.
        """
        fixed = self.scene.solver.time_step if self.tissue.dynamic else dt
        if not dt > 0 or not math.isclose(dt, fixed):
            raise CommandError(f"dt = {dt!r}: must be {fixed:g} s")
        before = self.position[_PLANE]
        self._move(command, dt)
        rotation = rotation_matrix(self.orientation)
        # Columns of R_e (Eq. 12): deflection direction and axis of the needle in the plane.
        side, axis = rotation[_PLANE, 0], rotation[_PLANE, 2]
        base = self.position[_PLANE]
        advance = float((base - before) @ axis)
        if self._nodes:
            self._travel(base, axis)
        if self._nodes:
            process = classify(False, True, advance)
            contact, moved = self._couple(process, base, side, axis, dt)
        else:
            contact, moved = self._touch(base, side, axis)
            process = classify(contact.tip > 0, False, advance)
        self.tissue.accept(moved)
        self.time += dt
        shown = np.zeros((len(self._markers), 3))
        shown[:, _PLANE] = self.tissue.inside(self._markers, moved)
        return PaperState(
            time=self.time,
            process=process,
            insertion_depth=self._depth,
            friction_force=contact.friction,
            tip_force=contact.tip,
            tip_deflection=np.array([contact.deflection, 0.0, 0.0]),
            base_force=np.array([-contact.lateral, 0.0, -contact.friction - contact.tip]),
            marker_displacements=shown,
            needle_nodes=len(self._nodes),
        )

    def _move(self, command: BaseCommand, dt: float) -> None:
        if command.position is not None:
            self.position = np.array(command.position)
        if command.orientation is not None:
            self.orientation = np.array(command.orientation)
        if command.velocity is not None:
            self.position = self.position + dt * command.velocity
        if command.angular_velocity is not None:
            self.orientation = turn(self.orientation, command.angular_velocity, dt)

    def _touch(self, base: Array, side: Array, axis: Array) -> tuple[_Contact, Array]:
        """Process 1, Eqs. (9) to (14): the needle stands off or presses on the surface."""
        tissue, needle = self.tissue, self.scene.needle
        free = tissue.solve(tissue.history())
        # The undeflected tip against the surface point below it.
        tip = base + needle.length * axis
        entry = tissue.mesh.surface(float(tip[0] - axis[0] * tip[1] / axis[1]))
        coupling = Coupling([entry])
        lifted = tissue.at(coupling, free)[0]
        gap = tip - entry.point - lifted
        if gap @ axis <= 0:
            return _Contact(), free
        frame = np.stack([axis, side], axis=1)
        loads = [tissue.spread(coupling, direction[None]) for direction in frame.T]
        answers = np.stack([tissue.solve(load) for load in loads], axis=1)
        compliance = np.stack([frame.T @ tissue.at(coupling, a)[0] for a in answers.T], axis=1)

        def pressed(deflection: float) -> Array:
            """Return the axial and lateral force on the tissue with the needle bent so far."""
            return np.linalg.solve(compliance, frame.T @ gap + [0.0, deflection])

        spring = 3 * needle.flexural_rigidity / needle.length**3  # K_1 of Fig. 4
        first = -float(pressed(0.0)[1])  # state 1, Eq. (9)
        bent = first / spring
        second = -float(pressed(bent)[1]) - first  # state 2, Eq. (10)
        deflection = -(first**2) / ((second - first) * spring) if first else 0.0  # Eq. (11)
        if abs(side[1]) > 1e-12:
            reach = needle.length / (side[1] / side[0])  # x_0 cot(theta)
            deflection = deflection * reach / (reach - deflection)  # Eq. (14)
        forces = pressed(deflection)
        moved = free + answers @ forces
        if forces[0] >= (self.scene.interaction.puncture.force or 0.0):
            self._nodes = [entry]
            self._tip = entry.point
            self._heading = self._turned(axis, side, 0.0)
        return _Contact(tip=forces[0], lateral=forces[1], deflection=deflection), moved

    def _turned(self, axis: Array, side: Array, slope: float) -> Array:
        """Return the unit direction at `slope` to the needle's base, turned by the bevel."""
        tip = self.scene.needle.tip
        angle = slope + tip.deviation_angle * math.cos(tip.roll)
        direction: Array = axis * math.cos(angle) + side * math.sin(angle)
        return direction

    def _travel(self, base: Array, axis: Array) -> None:
        """Bring the tip to where the base puts it, along the track or on into new tissue."""
        reach = float(base @ axis) + self.scene.needle.length
        there = self._tip + self.tissue.inside(self._tip, self.tissue.displacement)[0]
        step = (reach - float(there @ axis)) / float(self._heading @ axis)
        before, self._depth = self._depth, self._depth + step
        if step > 0:
            start, self._tip = self._tip, self._tip + step * self._heading
            self._nodes += self.tissue.mesh.crossings(
                start, self._tip, before, self._nodes[-1].arclength
            )
            return
        if self._depth < 0:
            self._withdraw()
            return
        ahead, far = self._tip, before
        while self._nodes[-1].arclength > self._depth:
            node = self._nodes.pop()
            ahead, far = node.point, node.arclength
        behind = self._nodes[-1]
        if far > behind.arclength:
            self._heading = (ahead - behind.point) / (far - behind.arclength)
            self._tip = behind.point + (self._depth - behind.arclength) * self._heading

    def _couple(
        self, process: Process, base: Array, side: Array, axis: Array, dt: float
    ) -> tuple[_Contact, Array]:
        """Processes 2 to 4: friction and cutting loaded, needle and tissue solved together."""
        scene, tissue, nodes = self.scene, self.tissue, self._nodes
        along = np.array([node.arclength for node in nodes])
        friction = self._friction(process, along)
        if process is Process.INSERTION:
            self._cutting = scene.interaction.cutting.force
        elif process is Process.HOLD:
            self._cutting *= math.exp(-dt / scene.interaction.cutting.relaxation_time)
        else:
            self._cutting = 0.0
        axial = friction.copy()
        axial[-1] += self._cutting

        arclengths = scene.needle.length - (self._depth - along)
        rigidity = scene.needle.flexural_rigidity
        flexibility = printed_flexibility(arclengths, rigidity)
        needle = np.asarray(np.linalg.inv(flexibility), dtype=float)  # Eq. (7)
        # Tissue displacement at which the needle would be straight.
        straight = (base - np.array([node.point for node in nodes])) @ side
        coupling = Coupling(nodes)
        forces = np.outer(axial, axis) + np.outer(needle @ straight, side)
        load = tissue.history() + tissue.spread(coupling, forces)
        moved = tissue.solve_with(needle, side, coupling, load)

        on_needle = needle @ (tissue.at(coupling, moved) @ side - straight)
        slope = float(printed_tip_slope(arclengths, rigidity) @ on_needle)
        tip = self._tip + tissue.inside(self._tip, moved)[0]
        if process is Process.INSERTION:
            self._steer(axis, side, slope, moved)
        contact = _Contact(
            friction=float(friction.sum()),
            tip=self._cutting,
            lateral=-float(on_needle.sum()),
            deflection=float((tip - base) @ side),
        )
        return contact, moved

    def _friction(self, process: Process, along: Array) -> Array:
        """Return the axial friction at the needle nodes: per length times their share of it."""
        if process is Process.INSERTION:
            self._sense = 1.0
        elif process is Process.RETRACTION:
            self._sense = -1.0
        borders = np.concatenate([[0.0], (along[1:] + along[:-1]) / 2, [self._depth]])
        force: Array = self._sense * self.scene.interaction.friction.kinetic * np.diff(borders)
        return force

    def _steer(self, axis: Array, side: Array, slope: float, moved: Array) -> None:
        """Set the direction in which the tip cuts on, in undeformed tissue."""
        ahead = self._turned(axis, side, slope)
        # Pull back by the displacement's change along it, over a cell's width.
        reach = float(min(self.tissue.mesh.cell)) / 2
        ends = self.tissue.inside(np.stack([self._tip, self._tip - reach * ahead]), moved)
        pulled = ahead - (ends[0] - ends[1]) / reach
        self._heading = pulled / np.linalg.norm(pulled)
