# SPDX-License-Identifier: Apache-2.0
"""One step of the needle in the tissue: contact, puncture, insertion, hold, retraction.

Replaces the iteration of Fig. 10 and the stiffness coupling of Eqs. (17) and (22) to (24):
the lateral forces, the friction and the tip force of a step are the solution of one
bounded convex problem in the compliances of tissue and needle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from needle_sim_ros.errors import CommandError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.balance import Balance
from needle_sim_ros.interaction.friction import STILL, FrictionMemory
from needle_sim_ros.interaction.growth import TrackGrowth
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.solution import BalanceSolution
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.step import Step
from needle_sim_ros.interaction.stretches import tip_bound
from needle_sim_ros.interaction.track import Track, TrackLayer
from needle_sim_ros.needle import tip
from needle_sim_ros.scene import Scene

# of the cutting rate of the last step, how much the next one is taken to cut beforehand
_FORESIGHT = 0.995
# how close to the cut a step has to come, of its advance: what the tip bears must not hang on
# it, nor what is dragged along after a stop, when the tip makes up for what is missing
_CLOSE = 0.01
_MOST_ROUNDS = 400
# of a segment: just before its middle, where the heading is taken; as close to it a round goes on
_MIDDLE, _THERE = 0.499, 0.009
# a cut foreseen too far is taken back by what the tip's compliance says and a part more, so
# often; then by halves
_BY_LACK, _MORE = 3, 1.3
# of what the tip may be beside its place, how much it may be ahead of it with less force, and
# how much it may have cut without the force that it takes
_SLIGHT, _UNCUT = 0.05, 0.02
# how far the tip may end from where a step took it to be, in track spacings: of a long step,
# of a short one, and of one that is shorter than that
_SETTLED, _NEAR, _NEAREST = 0.02, 0.001, 0.0001
# of a step: as late as the surface is broken for sure
_BROKEN = 1e-6


class Broken(NamedTuple):
    """How the surface breaks within a step.

    Attributes
    ----------
    share : float
        Of the step, after which it does: forces change evenly as base and tissue move.
    onward : ndarray, shape (1, d)
        Forces at the step's end if it did not, N.
    """

    share: float
    onward: Vector


class Contact:
    """The contact between one needle and one tissue.

    Parameters
    ----------
    scene : Scene
    layer : TrackLayer
    laws : Laws

    Attributes
    ----------
    close : float
        How close to the cut the tip has to come in a step, of its advance.
    """

    close = _CLOSE

    def __init__(self, scene: Scene, layer: TrackLayer, laws: Laws) -> None:
        self._scene, self.layer, self.laws = scene, layer, laws
        self._balance = Balance(scene, laws)
        self._growth = TrackGrowth(scene, layer, self._balance)
        self._bevel = tip.spread_length(scene.needle)
        self._half = np.array(scene.tissue.size) / 2
        self._dimension = scene.dimension

    def at_rest(self) -> ContactState:
        """Return the state of a needle that has touched nothing."""
        d = self._dimension
        return ContactState(
            lateral=np.empty((d - 1, 0)), moved=np.empty((0, d)), forces=np.empty((0, d))
        )

    def change_laws(self, laws: Laws, state: ContactState) -> ContactState:
        """Take other laws from now on; return the state with the limits of its track."""
        self.laws = self.layer.laws = self._balance.laws = laws
        if state.track is None:
            return state
        return state._replace(track=state.track.with_limits(laws))

    def step(self, state: ContactState, step: Step) -> ContactState:
        """Return the state at the end of a step.

        Raises
        ------
        CommandError
            When the step would take the needle where the model ends.
        """
        if not state.inserted:
            state = self._approach(state, step)
        if not (state.touching or state.inserted):
            return state
        if state.touching:
            state = self._press(state, step)
            if not state.inserted:
                return state
        return self._slide(state, step)

    # ------------------------------------------------------------------ above the surface
    def _tip(self, pose: BasePose) -> Vector:
        return np.asarray(pose.origin + self._scene.needle.length * pose.axial)

    def meets(self, state: ContactState, before: BasePose, after: BasePose) -> bool:
        """Tell whether a free tip gets through the level of the surface on the way."""
        if state.touching or state.inserted:
            return False
        return bool(self._tip(after)[-1] < 0 <= self._tip(before)[-1])

    def _approach(self, state: ContactState, step: Step) -> ContactState:
        """Find out whether the free tip meets the surface or the old channel."""
        if state.touching:
            return state
        ends = self._tip(step.after)
        if ends[-1] >= 0:
            return self._released(state, step)
        starts = self._tip(step.before)
        part = starts[-1] / (starts[-1] - ends[-1]) if starts[-1] > 0 else 0.0
        entry = starts + part * (ends - starts)
        entry[-1] = 0.0
        if (np.abs(entry[:-1]) > self._half[:-1]).any():
            if (np.abs(ends[:-1]) < self._half[:-1]).all() and ends[-1] > -2 * self._half[-1]:
                raise CommandError(
                    f"the tip would enter the tissue through a side, at {ends.tolist()} m"
                )
            return self._released(state, step)
        if self._meets_channel(state, entry):
            return self._released(state, step)._replace(inserted=True, depth=0.0, rate=0.0)
        # a free tip below the surface is in the dent that it left (dynamics), or underneath
        if starts[-1] < -2 * self._half[-1]:
            if ends[-1] <= -2 * self._half[-1]:
                return self._released(state, step)
            raise CommandError(f"the tip would enter the tissue from below, at {ends.tolist()} m")
        track = self.layer.touch(entry, step.after.axial)
        fresh = self.at_rest()
        return fresh._replace(
            track=track,
            touching=True,
            moved=np.zeros((1, self._dimension)),
            forces=np.zeros((1, self._dimension)),
        )

    def _meets_channel(self, state: ContactState, entry: Vector) -> bool:
        if state.track is None or state.front <= 0:
            return False
        return bool(np.linalg.norm(entry - state.track.points[0]) <= self._scene.needle.radius)

    def _released(self, state: ContactState, step: Step) -> ContactState:
        track = state.track
        if track is not None and state.front <= 0:
            track = None
        rest = self.at_rest()._replace(track=track, front=state.front if track else 0.0)
        if track is None:
            return rest
        zero = np.zeros_like(track.points)
        return rest._replace(moved=step.free(track.table), forces=zero)

    # --------------------------------------------------------------- before the puncture
    def _press(self, state: ContactState, step: Step) -> ContactState:
        """Contact of the tip with the unbroken surface (Eqs. 9 to 14)."""
        assert state.track is not None
        limit = self.laws.at(state.track.points[0]).puncture
        solution = self._balance.touch(state.track, step, limit)
        if solution.overlap <= 0:
            return self._unbroken(state, step, solution)
        # the surface breaks: the same step goes on with a track
        pressed = state.track._replace(dent=self._balance.dent(limit))
        track = self._growth.opened(pressed, step, solution, solution.forces)
        # friction starts from the dented tissue: what the tip did to the new point counts
        forces = np.zeros_like(track.points)
        forces[:1] = state.forces
        moved = _known(state.moved, forces, track, step)
        return self.at_rest()._replace(track=track, inserted=True, moved=moved, forces=forces)

    def _unbroken(self, state: ContactState, step: Step, solution: BalanceSolution) -> ContactState:
        if solution.tip <= 0:
            return self._released(state._replace(front=0.0), step)
        return state._replace(**solution.fields(), touching=True)

    def pressed(self, state: ContactState, step: Step) -> ContactState | Broken | None:
        """Return the state after a step whose tip presses on the surface, or how that breaks.

        None where it breaks at the step's very end.
        """
        assert state.track is not None
        limit = self.laws.at(state.track.points[0]).puncture
        pressed = self._balance.touch(state.track, step, math.inf)
        if pressed.tip <= limit:
            return self._unbroken(state, step, pressed)
        share = (limit - state.tip) / (pressed.tip - state.tip) + _BROKEN
        return Broken(share, pressed.forces) if 0.0 < share < 1.0 - _BROKEN else None

    # ----------------------------------------------------------------- in the tissue
    def _slide(self, state: ContactState, step: Step) -> ContactState:
        """Insertion, hold and retraction: find the forces and how far the tip gets."""
        assert state.track is not None
        advance = step.advance
        heading = 0 if abs(advance) <= STILL else (1 if advance > 0 else -1)
        rate = state.rate if heading == state.heading else 0.0
        track, depth, front = self._turned(state, step, heading > 0)
        began, deepest = depth, front
        engaged = depth >= front
        if engaged and heading > 0:
            depth = front = front + _FORESIGHT * rate * advance
        elif not engaged:
            depth = min(max(depth + rate * advance, 0.0), front)
        moved, forces = state.moved, state.forces
        memory = FrictionMemory(state.slip, state.strain, state.slid, state.advance, state.lasted)
        reached, missed = deepest, math.inf  # how far the tip cuts at least, and does not
        nearly = _SETTLED * track.spacing
        if heading:
            near = track.spacing * (_NEAR if abs(advance) > _NEAR * track.spacing else _NEAREST)
            nearly = min(nearly, max(self.close * abs(advance), near))
        status = state.status
        opened = not len(status)
        solves = tries = 0
        solution = None
        for _ in range(_MOST_ROUNDS):
            bent = solution or state
            track = self._growth.grown(track, step, bent, forces, depth, heading > 0)
            moved = _known(moved, forces, track, step)
            limit = self._tip_limit(state, track, front, engaged, step)
            solution = self._balance.inserted(track, step, moved, memory, status, depth, limit)
            solves += solution.solves
            forces = solution.forces
            change = solution.overlap / step.after.cosine(track.direction(depth))
            if engaged and heading > 0:
                track = self._growth.cut(track, step, solution, depth)
            if engaged:
                settled = abs(change) <= nearly
                if change > 0:
                    reached = front
                    front += min(change, _onward(front, track.spacing))
                    front = front if front < missed else 0.5 * (reached + missed)
                    depth = front
                elif front > deepest and solution.status[-1] <= 0:
                    # foreseen too far: a tip that bears less than its limit has not cut
                    settled = (
                        front - reached <= _UNCUT * nearly or solution.lack <= _SLIGHT * nearly
                    )
                    if not settled:
                        tries += 1
                        back = 0.5 * (reached + front)
                        if tries <= _BY_LACK:
                            back = max(reached, front - _MORE * solution.lack)
                        missed, depth, front = front, back, back
                elif change < 0:
                    depth, engaged = front + max(change, -track.spacing), False
            else:
                settled = abs(change) <= nearly and depth + change < front
                depth += min(max(change, -track.spacing), track.spacing)
                if depth >= front:
                    depth, engaged = front, True
            if depth <= 0 and heading <= 0:
                return self._drawn_out(track, front, step)
            depth = max(depth, 0.0)
            if settled and opened and heading > 0:
                # what slipped far as the tip snapped in rubs with what is left then
                memory = memory._replace(slid=solution.slid, advance=advance, lasted=step.duration)
                status, opened = solution.status, False
            elif settled:
                break
        assert solution is not None
        if depth >= self._scene.needle.length:
            raise CommandError(
                f"the needle's whole length, {self._scene.needle.length:g} m, would be inserted"
            )
        went = (depth - began) / advance if heading else 0.0
        if solves != solution.solves:
            solution = solution._replace(solves=solves)
        rate = min(max(went, 0.0), 1.0)
        bearing = limit if engaged else self.laws.relaxed(state.bearing, step.duration)
        place = (track, False, True, depth, front, rate, heading, bearing)
        return ContactState(*place, *solution.in_state())

    def _turned(
        self, state: ContactState, step: Step, going_in: bool
    ) -> tuple[Track, float, float]:
        """Return the track, aimed if that is due, and depths of tip and front along it, m.

        Both keep their places along the needle as the last segment turns.
        """
        assert state.track is not None
        depth, front = state.depth, state.front
        track = self._growth.turned(state.track, depth, going_in)
        if track is state.track:
            return track, depth, front
        pose = step.before
        apart = pose.reach(state.track.place(front)) - pose.reach(track.place(front))
        shift = apart / pose.cosine(track.direction(front))
        return track, depth + shift, front + shift

    def _drawn_out(self, track: Track, front: float, step: Step) -> ContactState:
        zero = np.zeros_like(track.points)
        moved = step.free(track.table)
        return self.at_rest()._replace(track=track, front=front, moved=moved, forces=zero)

    def _tip_limit(
        self,
        state: ContactState,
        track: Track,
        front: float,
        engaged: bool,
        step: Step,
    ) -> float:
        """Return what the tip may bear, N: cutting while it advances, less and less in a hold.

        What it may bear relaxes, not what it bears: a tip that was unloaded for an instant is
        loaded again as it was.
        """
        if not engaged:
            return 0.0
        mean, opening = tip_bound(track.stretches, front, self._bevel)
        cutting = self.laws.cutting(mean, front) + opening
        if step.fallen < 1.0:
            broken = self.laws.at(track.points[0]).puncture
            cutting = broken + step.fallen * (cutting - broken)
        if step.advance <= STILL:
            cutting = min(cutting, self.laws.relaxed(state.bearing, step.duration))
        return cutting


def _onward(front: float, spacing: float) -> float:
    """Return how far a round may cut: to the middle of a segment, where it takes its heading."""
    passed = front / spacing
    middle = math.floor(passed + 1 - _MIDDLE + _THERE) + _MIDDLE
    return spacing * (middle - passed)


def _known(moved: Vector, forces: Vector, track: Track, step: Step) -> Vector:
    """Give points laid within the step the displacement that the forces so far give them."""
    known = len(moved)
    if known == track.laid:
        return moved
    wider = step.free(track.table) + track.table.displacement(step.yielding * forces)
    wider[:known] = moved
    return wider
