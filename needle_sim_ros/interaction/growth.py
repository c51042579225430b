# SPDX-License-Identifier: Apache-2.0
"""How the track grows ahead of the cutting tip.

A point is foreseen, aimed, weighed and laid in stages while the tip passes the segment
before it, so that at usual speeds no tick bears the whole work.
"""

from __future__ import annotations

import numpy as np

from needle_sim_ros.errors import CommandError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.balance import Balance
from needle_sim_ros.interaction.coupling import added_up
from needle_sim_ros.interaction.solution import BalanceSolution
from needle_sim_ros.interaction.state import AIMED, ContactState
from needle_sim_ros.interaction.step import Step
from needle_sim_ros.interaction.track import NextPoint, Track, TrackLayer
from needle_sim_ros.needle import tip
from needle_sim_ros.scene import Scene

# how far the tip may be beyond the last point of a track that cannot go on, in track spacings
_BEYOND = 0.5
# parts of a segment that the tip has passed at each stage; the point is laid at the last
_FORESEEN, _SPREAD, _ASKED, _WEIGHED = 0.1, 0.54, 0.64, 0.68
_APPENDED, _LAID = 0.91, 0.94
# ... and from there to each further step of it: a footprint that is added up, a component
# that is read where it is foreseen; in asking, and in weighing
_EACH, _EACH_ASKED, _EACH_WEIGHED = 0.06, 0.03, 0.04
# after the components that are read
_READ_BEYOND = 0.42
# of a segment: as close before its middle is as good
_NEARLY = 0.01
# of a segment: as far beyond it has to be aimed within a step
_LATE = 0.06


class TrackGrowth:
    """Keeps the track ahead of the tip.

    Parameters
    ----------
    scene : Scene
    layer : TrackLayer
    balance : Balance
    """

    def __init__(self, scene: Scene, layer: TrackLayer, balance: Balance) -> None:
        self._needle, self._layer, self._balance = scene.needle, layer, balance
        self._bevel = tip.spread_length(scene.needle)
        self._half = np.array(scene.tissue.size) / 2
        self._dimension = scene.dimension
        # the tissue's turning is felt over the bevel: on longer segments headings differ by
        # more than the path's own turn, and foresight by the last one would overshoot
        self._foresight = 2 * scene.solver.track_spacing <= self._bevel

    def opened(self, track: Track, step: Step, bent: BalanceSolution, forces: Vector) -> Track:
        """Return a track of one point with the second one, where the broken surface leads."""
        direction = self._cut(step, bent)
        place = self._layer.coupling.turning(track.points[0], direction, self._bevel)
        known = NextPoint(turning=track.table.reading(added_up(place)))
        heading = self._pulled_back(step, track, direction, forces, known)
        return self._layer.extend(self._layer.aim(track, heading))

    def grown(
        self,
        track: Track,
        step: Step,
        bent: ContactState | BalanceSolution,
        forces: Vector,
        depth: float,
        going_in: bool,
    ) -> Track:
        """Return the track with whatever the tip at a depth calls for."""
        layer = self._layer
        while True:
            passed = depth / track.spacing - (track.laid - 2)
            ahead = track.ahead
            if ahead is None:
                if passed < _FORESEEN:
                    return track
                track = layer.foresee(track, self._bevel)
            elif ahead.shares is not None:
                if passed < (_FORESEEN if ahead.point is None else _SPREAD) + _EACH:
                    return track
                track = layer.gather(track)
            elif ahead.turning is not None and len(ahead.turning.columns) < self._dimension:
                if passed < _FORESEEN + _EACH * (2 + len(ahead.turning.columns)):
                    return track
                track = layer.read(track)
            elif layer.near is not None and ahead.near is None and ahead.point is None:
                if passed < _READ_BEYOND:
                    return track
                track = layer.read_beyond_mesh(track, self._bevel)
            elif ahead.point is None:
                if passed < AIMED + _LATE:
                    return track
                heading = ahead.heading
                if heading is None:
                    direction = self._cut(step, bent)
                    heading = self._pulled_back(step, track, direction, forces, ahead)
                aimed = self._aimed(track, heading, passed, going_in)
                if aimed is None:
                    return track
                track = aimed
            elif ahead.footprint is None:
                if passed < _SPREAD:
                    return track
                track = layer.spread(track)
            elif not ahead.asked:
                if passed < _ASKED + (0.0 if ahead.onward is None else _EACH_ASKED):
                    return track
                track = layer.ask(track, step.advance / step.duration)
            elif ahead.row is None:
                done = len(ahead.columns) + ahead.beyond.known
                if passed < _WEIGHED + _EACH_WEIGHED * done:
                    return track
                track = layer.weigh(track)
            elif ahead.table is None:
                if passed < _APPENDED:
                    return track
                track = layer.append(track, step.after.terms)
            elif passed >= _LAID:
                track = layer.extend(track)
            else:
                return track

    def turned(self, track: Track, depth: float, going_in: bool) -> Track:
        """Return the track aimed, if it is known where to, or as it is."""
        ahead = track.ahead
        if ahead is None or ahead.heading is None or ahead.point is not None:
            return track
        passed = depth / track.spacing - (track.laid - 2)
        return self._aimed(track, ahead.heading, passed, going_in) or track

    def _aimed(self, track: Track, heading: Vector, passed: float, going_in: bool) -> Track | None:
        """Aim the track; None where it cannot go on and need not."""
        aimed = self._layer.aim(track, heading, self._foresight)
        assert aimed.ahead is not None and aimed.ahead.point is not None
        if self._in_tissue(aimed.ahead.point):
            return aimed
        # there is room up to the last point; who holds or draws back may be a
        # little beyond it, and must always be able to draw back
        if passed < 1.0 or (not going_in and passed < 1.0 + _BEYOND):
            return None
        raise CommandError(f"the tip would leave the tissue at {aimed.ahead.point.tolist()} m")

    def cut(self, track: Track, step: Step, solution: BalanceSolution, depth: float) -> Track:
        """Return the track with the direction of the cut, if a step ends where that is due.

        The next one aims the track by it: where the tip is then, the needle may be bent and
        the tissue turned otherwise.
        """
        ahead = track.ahead
        if ahead is None or ahead.point is not None or ahead.heading is not None:
            return track
        if depth / track.spacing - (track.laid - 2) < AIMED - _NEARLY or not self._turns(ahead):
            return track
        direction = self._cut(step, solution)
        heading = self._pulled_back(step, track, direction, solution.forces, ahead)
        return track._replace(ahead=ahead._replace(heading=heading))

    def _turns(self, ahead: NextPoint) -> bool:
        """Tell whether it is known how the tissue ahead of the tip is turned."""
        if self._layer.near is not None and ahead.near is None:
            return False
        return ahead.turning is not None and len(ahead.turning.columns) == self._dimension

    def _cut(self, step: Step, bent: ContactState | BalanceSolution) -> Vector:
        pose = step.after
        slope = self._balance.slope(bent)
        return tip.cutting_direction(self._needle, pose.axial, pose.lateral, slope)

    def _in_tissue(self, point: Vector) -> bool:
        deep = -2 * self._half[-1] <= point[-1] <= 0
        return bool(deep and (np.abs(point[:-1]) <= self._half[:-1]).all())

    def _pulled_back(
        self,
        step: Step,
        track: Track,
        direction: Vector,
        forces: Vector,
        ahead: NextPoint,
    ) -> Vector:
        """Return the direction of the next piece of track, in the undeformed tissue.

        The direction in space is pulled back by how the tissue ahead of the tip is turned,
        over the bevel length: a length of the needle, not of the mesh.
        """
        if ahead.turning is None or not forces.any():
            return direction
        material = direction - step.sample(track.table, forces, ahead.turning)
        if ahead.near is not None:
            material -= ahead.near.by(forces)
        return np.asarray(material / np.linalg.norm(material))
