# SPDX-License-Identifier: Apache-2.0
"""One tick of the coupled model; the only stateful class."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import CommandError, SceneError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.contact import Contact
from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.process import Process, classify
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.track import TrackLayer
from needle_sim_ros.observation import Observation
from needle_sim_ros.scene import Scene
from needle_sim_ros.statistics import Statistics
from needle_sim_ros.tick.base_motion import AT_REST, check, commanded, jumps
from needle_sim_ros.tick.coupled_step import Coupled, CoupledStep
from needle_sim_ros.tick.division import Division, caught
from needle_sim_ros.tick.route import Route
from needle_sim_ros.tissue.build import BuiltTissue, build_tissue, fixed_parts, plane_points
from needle_sim_ros.tissue.near_field import NearField, disc_radius
from needle_sim_ros.tissue.response import ResponseTable

# rows of responses for which there is room from the start, at most
_MOST_ROWS = 400
# time steps that settle after points of the track are caught: the force that holds them rings
# longer than what the base's own velocity sends
_CAUGHT = 2


class Snapshot(NamedTuple):
    """Everything a simulation remembers; made and taken by :class:`Simulator`."""

    time: float
    ticks: int
    position: Vector
    orientation: Vector
    pose: BasePose
    rate: tuple[float, ...]  # of the base in the last tick
    unsettled: int  # time steps to come in which the tissue's velocity has to settle
    parts: int  # that the last tick was solved in
    process: Process
    contact: ContactState
    tissue: Any
    scene: Scene  # with the laws of that time


class Simulator:
    """The coupled needle and tissue of a scene.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called with (done, total) while the tissue is prepared.

    Examples
    --------
    >>> sim = Simulator(Scene.load("gao2016"))
    >>> obs = sim.step(BaseCommand(velocity=[0, 0, -3e-3]), dt=0.01)
    """

    def __init__(self, scene: Scene, progress: Callable[[int, int], None] | None = None) -> None:
        self._take(scene, build_tissue(scene, progress))

    def _take(self, scene: Scene, built: BuiltTissue) -> None:
        self.scene, self._built = scene, built
        self.statistics = Statistics()
        self._model, self._factor, self._dynamics = built.model, built.factor, built.dynamics
        self.preparation = built.preparation
        coupling = Coupling(self._model, disc_radius(scene))
        laws = Laws(scene)
        near = NearField(scene) if coupling.radius > scene.needle.radius else None
        empty = ResponseTable(
            self._dynamics.compliance, self._dynamics.modes, _rows(scene), near is not None
        )
        self._empty = empty
        self._markers = np.array(scene.markers, dtype=float).reshape(-1, 3)
        spacing = scene.solver.track_spacing
        layer = TrackLayer(coupling, laws, empty, spacing, near, self._markers)
        self._contact_laws = Contact(scene, layer, laws)
        solver = scene.solver
        self._own_step = solver.time_step if solver.dynamics == "newmark" else None
        self._division = Division(scene, self._contact_laws)
        self._stepper = CoupledStep(
            self._dynamics, self._contact_laws, empty, self._division, scene
        )
        self._start = self._initial()
        self._state = self._start
        self._observation: Observation | None = None

    def variant(self, scene: Scene) -> Simulator:
        """Return a simulator of a similar scene on this one's factorised tissue; takes no time.

        Needle (but its radius), tip, laws, base and protocol may differ. The mesh stays
        graded to the planned path of this simulator's scene. The two share what the tissue
        computes on demand, so they must not tick in different threads.

        Raises
        ------
        SceneError
            When tissue, markers, solver, dimension or needle radius differ.
        """
        mine, other = fixed_parts(self.scene), fixed_parts(scene)
        for key, value in other.items():
            if mine[key] != value:
                raise SceneError(key, value, "a variant on the same tissue must keep it")
        twin = Simulator.__new__(type(self))
        twin._take(scene, self._built)
        return twin

    def _initial(self) -> Snapshot:
        scene = self.scene
        quaternion = np.array(scene.base.orientation, dtype=float)
        quaternion /= np.linalg.norm(quaternion)
        position = np.array(scene.base.position, dtype=float)
        return Snapshot(
            0.0,
            0,
            position,
            quaternion,
            BasePose.of(position, quaternion, scene.dimension),
            AT_REST,
            0,
            1,
            Process.FREE,
            self._contact_laws.at_rest(),
            self._dynamics.initial(),
            scene,
        )

    def prepare_beside(self) -> None:
        """Begin to prepare, beside the ticks, what a needle steered off its plan calls for.

        Worth it in real time: what is not there when a tick needs it, the tick waits for.
        """
        self._built.beside.start()

    @property
    def prepared_beside(self) -> float:
        """What part of that is prepared, 0 to 1."""
        return self._built.beside.share

    # ------------------------------------------------------------------------- ticking
    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._state.time

    @property
    def ticks(self) -> int:
        """Ticks since the start or the last reset."""
        return self._state.ticks

    @property
    def unknowns(self) -> int:
        """Number of displacements of the tissue that are not fixed."""
        return len(self._model.free)

    @property
    def nodes(self) -> int:
        """Number of nodes of the tissue's mesh."""
        return self._model.nodes

    def step(self, command: BaseCommand, dt: float) -> Observation:
        """Move the base for a tick and find out what needle and tissue do.

        Parameters
        ----------
        command : BaseCommand
        dt : float
            Duration of the tick, s, > 0; with Newmark a whole multiple of
            ``solver.time_step``.

        Raises
        ------
        CommandError
            When the command cannot be carried out; the state is unchanged.
        """
        began = time.perf_counter()
        state = self._state
        dt = self._checked(dt)
        motion = commanded(command, state.position, state.orientation, dt)
        check(self.scene, state.contact, state.pose, state.position, state.orientation, motion)
        here = Coupled(state.contact, state.tissue, state.pose)
        route = Route(state.position, state.orientation, state.pose, motion, dt, state.rate)
        steps, equal, unsettled = self._steps(state, route)
        advance, parts = 0.0, 0
        for number in range(steps):
            was = here.contact
            if not unsettled and self._contact_laws.meets(
                was, here.pose, route.at((number + 1) / steps)
            ):
                unsettled = 1
            settling = unsettled > 0 and self._dynamics.settles
            halves = 2 if settling else 1
            for half in range(number * halves, (number + 1) * halves):
                span = half / (halves * steps), (half + 1) / (halves * steps)
                here, moved, count = self._stepper.carry_out(here, route, span, equal, settling)
                advance += moved
                parts += count
            unsettled = max(unsettled - 1, self._altered(was, here.contact))
        contact = here.contact
        process = classify(contact.touching, contact.inserted, advance)
        self._state = Snapshot(
            state.time + dt,
            state.ticks + 1,
            motion.position,
            motion.orientation,
            here.pose,
            motion.rate,
            unsettled,
            parts,
            process,
            contact,
            here.tissue,
            state.scene,
        )
        self._observation = None
        self.statistics.solves = self._factor.solves
        self.statistics.waits = self._dynamics.compliance.waits
        self.statistics.tick(time.perf_counter() - began, contact.solves, contact.residual)
        return self.observe()

    def _altered(self, was: ContactState, now: ContactState) -> int:
        """Return how many time steps it takes to settle that contact began, broke or caught."""
        if (was.touching, was.inserted) != (now.touching, now.inserted):
            return 1
        return _CAUGHT if self._dynamics.settles and caught(was, now) else 0

    def _checked(self, dt: float) -> float:
        dt = float(dt)
        if not (math.isfinite(dt) and dt > 0):
            raise CommandError(f"dt = {dt!r}: must be finite and > 0, in s")
        if self._own_step is not None:
            count = round(dt / self._own_step)
            if count < 1 or abs(count * self._own_step - dt) > 1e-9 * dt:
                raise CommandError(
                    f"dt = {dt:g}: must be a whole multiple of solver.time_step, "
                    f"{self._own_step:g} s, with Newmark"
                )
        return dt

    def _steps(self, state: Snapshot, route: Route) -> tuple[int, int, int]:
        """Return time steps of a tick, equal parts of each, and how many have to settle.

        The parts are 0 where each step decides for itself.
        """
        contact, unsettled = state.contact, 0
        if contact.inserted or contact.touching:
            jump = jumps(route.motion.rate, state.rate, self.scene.needle.length)
            unsettled = max(state.unsettled, jump)
        if self._own_step is None:
            return 1, self._division.of_tick(contact, route, unsettled > 0), 0
        return round(route.duration / self._own_step), 0, unsettled

    # --------------------------------------------------------------------- observing
    def observe(self) -> Observation:
        """Return what can be seen now."""
        if self._observation is None:
            s = self._state
            self._observation = Observation(
                s.time,
                s.process,
                s.contact.depth if s.contact.inserted else 0.0,
                s.position,
                s.orientation,
                self._markers,
                self.scene,
                s.pose,
                s.contact,
                self._dynamics,
                s.tissue,
                self._empty,
            )
        return self._observation

    def tissue_displacement(
        self, points: ArrayLike, observation: Observation | None = None
    ) -> Vector:
        """Return the displacement of reference points of the tissue.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            Tissue frame, m; a 2D scene ignores y.
        observation : Observation, optional
            Of this simulator: the displacement at that instant instead of now. It may be
            asked for from another thread while this one ticks.

        Returns
        -------
        ndarray, shape (n, 3)
            m; nan outside the tissue.
        """
        where = plane_points(np.asarray(points, dtype=float), self.scene.dimension)
        nodes, values, inside = self._model.shape_functions(where)
        field = (observation or self.observe()).tissue_field()
        moved = np.einsum("kb,kbd->kd", values, field[nodes])
        moved[~inside] = np.nan
        if self.scene.dimension == 3:
            return np.asarray(moved)
        return np.column_stack([moved[:, 0], np.where(inside, 0.0, np.nan), moved[:, 1]])

    # ------------------------------------------------------------- branching, repeating
    def snapshot(self) -> Snapshot:
        """Return the state, exactly; costs nothing."""
        return self._state

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a state of this simulator, exactly; its laws of that time too."""
        if not isinstance(snapshot, Snapshot):
            raise CommandError(f"not a snapshot: {type(snapshot).__name__}")
        if snapshot.scene is not self.scene:
            self._contact_laws.change_laws(Laws(snapshot.scene), snapshot.contact)
            self.scene = snapshot.scene
        self._state = snapshot
        self._observation = None

    def reset(self) -> Observation:
        """Go back to the start; laws that were changed stay changed."""
        self._state = self._start._replace(scene=self.scene)
        self._observation = None
        return self.observe()

    def rollout(
        self,
        commands: Iterable[BaseCommand],
        dt: float,
        quantities: Sequence[str] = ("time", "insertion_depth", "tip_position", "base_force"),
    ) -> dict[str, Vector]:
        """Step through commands and return trajectories of the wanted quantities only.

        Parameters
        ----------
        commands : iterable of BaseCommand
            One per tick.
        dt : float
            s.
        quantities : sequence of str
            Members of :class:`Observation`.

        Returns
        -------
        dict of ndarray
            One array per quantity, the tick first.
        """
        unknown = [
            q
            for q in quantities
            if q.startswith("_")
            or (not hasattr(Observation, q) and q not in Observation.__dataclass_fields__)
        ]
        if unknown:
            raise CommandError(f"quantities = {unknown}: not members of Observation")
        series: dict[str, list[Any]] = {name: [] for name in quantities}
        for command in commands:
            observation = self.step(command, dt)
            for name, values in series.items():
                values.append(getattr(observation, name))
        return {name: np.array(values) for name, values in series.items()}

    def change_interaction(self, changes: Mapping[str, object]) -> None:
        """Change laws between ticks, e.g. ``{"friction.kinetic": 12.0}``.

        Raises
        ------
        SceneError
            On unknown keys or inadmissible values; nothing is changed then.
        """
        self.take_interaction(
            self.scene.with_changes({f"interaction.{k}": v for k, v in changes.items()})
        )

    def take_interaction(self, scene: Scene) -> None:
        """Take the laws of a scene that differs from this one's in `interaction` only.

        What :meth:`change_interaction` does once the scene is made and validated, which
        takes longer than a tick.
        """
        contact = self._contact_laws.change_laws(Laws(scene), self._state.contact)
        self.scene = scene
        self._state = self._state._replace(contact=contact, scene=scene)
        self._observation = None


def _rows(scene: Scene) -> int:
    """Return how many track points a needle has that is driven straight in, as far as it goes."""
    depth = min(scene.needle.length, scene.tissue.size[-1])
    return min(math.ceil(depth / scene.solver.track_spacing) + 2, _MOST_ROWS)
