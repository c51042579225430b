# SPDX-License-Identifier: Apache-2.0
"""The needle's track (Fig. 8): a polyline of material points of the tissue.

The advancing tip lays a point every h_t, one ahead of itself. The needle slides along the
track without remeshing, and the track stays as a channel when the needle is drawn out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction import stretches
from needle_sim_ros.interaction.coupling import Coupling, Shares, added_up
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.stretches import Stretch
from needle_sim_ros.tissue.compliance import Footprint
from needle_sim_ros.tissue.mesh import Index
from needle_sim_ros.tissue.near_field import NearField, Turning
from needle_sim_ros.tissue.response import Axes, Reading, ResponseRow, ResponseTable, Rows

# how far ahead of the tip responses are prepared: track spacings, at least so many m in 2D and
# 3D, where they take tens of milliseconds a millimetre, and what the base goes in so many s,
# up to so many m
_FORESEEN, _AT_LEAST = 14, {2: 0.01, 3: 0.03}
_LEAD, _FARTHEST = 0.6, 0.1
# ... and after how many new points they are looked at again
_EVERY = 4
# where on the pieces before and after a point the friction there is looked up
_NEAR = (-0.375, -0.125, 0.125, 0.375)


class BeyondMesh(NamedTuple):
    """What the mesh does not show of the response to a force on a point.

    Attributes
    ----------
    rows : ndarray, shape ((n + 1) d, d), or None
        Of the points of a track, its own last, m/N; nothing in 2D.
    readers : ndarray, shape (r, d), or None
        Of the readers.
    """

    rows: Vector | None = None
    readers: Vector | None = None

    @property
    def known(self) -> int:
        """How many parts of it are known."""
        return sum(part is not None for part in self)

    def added(self, row: ResponseRow) -> ResponseRow:
        """Return a row with it."""
        if self.rows is not None:
            row = row._replace(static=row.static + self.rows, near=self.rows)
        if self.readers is not None:
            row = row._replace(at_readers=row.at_readers + self.readers, near_read=self.readers)
        return row


class NextPoint(NamedTuple):
    """A point to be laid, as far as it is known.

    Attributes
    ----------
    shares : Shares or None
        Of the footprint that is to be known next.
    turning : Reading or None
        Tells how the tissue ahead of the tip is turned, as far as it is known.
    near : Turning or None
        What the mesh does not show of that.
    heading : ndarray, shape (d,), or None
        The cut's unit direction with the tip in the middle of the last segment.
    point : ndarray, shape (d,), or None
        Its place, m, when the track was aimed.
    footprint : Footprint or None
    onward : ndarray of int or None
        Nodes that what comes after it will touch, where these are to be asked for next.
    asked : bool
        Whether they were.
    rows : Rows or None
        Of the response table, and its own.
    columns : tuple of ndarray
        The first columns of its row.
    beyond : BeyondMesh
        What the mesh does not show of it, as far as it is known.
    row : ResponseRow or None
        The row.
    table : ResponseTable or None
        With it.
    """

    shares: Shares | None = None
    turning: Reading | None = None
    near: Turning | None = None
    heading: Vector | None = None
    point: Vector | None = None
    footprint: Footprint | None = None
    onward: Index | None = None
    asked: bool = False
    rows: Rows | None = None
    columns: tuple[Vector, ...] = ()
    beyond: BeyondMesh = BeyondMesh()
    row: ResponseRow | None = None
    table: ResponseTable | None = None


class Track(NamedTuple):
    """Track points, their limits and their responses; immutable.

    Attributes
    ----------
    spacing : float
        h_t, m.
    points : ndarray, shape (n, d)
        Reference positions, m.
    static, kinetic : ndarray, shape (n,)
        Friction limits at the points, N/m.
    table : ResponseTable
        One row per point.
    directions : ndarray, shape (n - 1, d)
        Of the segments, unit vectors.
    stretches : tuple of Stretch
        Where the limits at the tip change.
    heading : ndarray, shape (d,), or None
        Unit direction of the cut in the middle of the segment before the last.
    ahead : NextPoint or None
        The next point, as far as it is prepared.
    dent : float
        How far the tip was pressed into its own contact when the surface broke, m.
    """

    spacing: float
    points: Vector
    static: Vector
    kinetic: Vector
    table: ResponseTable
    directions: Vector
    stretches: tuple[Stretch, ...] = ()
    heading: Vector | None = None
    ahead: NextPoint | None = None
    dent: float = 0.0

    @property
    def entry(self) -> list[float]:
        """Coordinates of the first point, m."""
        entry: list[float] = self.points[0].tolist()
        return entry

    @property
    def laid(self) -> int:
        """Number of points n."""
        return len(self.points)

    @property
    def middle(self) -> Vector:
        """Middle of the last segment, (d,), m."""
        return np.asarray(0.5 * (self.points[-2] + self.points[-1]))

    def _with(
        self, point: Vector, table: ResponseTable, laws: Laws, heading: Vector | None = None
    ) -> Track:
        last = self.points[-1:]
        direction = (point - last) / self.spacing  # none where there is no last point
        limits = _rubbing(laws, point, self.spacing * direction)
        begun = self.stretches or stretches.first(laws, point)
        if self.laid:
            start = (self.laid - 1) * self.spacing
            begun = stretches.onward(
                begun, laws, start, self.points[-1], point - self.points[-1], self.spacing
            )
        return Track(
            self.spacing,
            np.vstack([self.points, point]),
            np.append(self.static, limits[0]),
            np.append(self.kinetic, limits[1]),
            table,
            np.vstack([self.directions, direction]),
            begun,
            heading,
            dent=self.dent,
        )

    def with_limits(self, laws: Laws) -> Track:
        """Return the track with the friction limits of changed laws."""
        pieces = [self.points[:0], *(self.points[1:] - self.points[:-1])[:, None]]
        pairs = zip(self.points, pieces, strict=True)
        static, kinetic = zip(
            *(_rubbing(laws, point, piece) for point, piece in pairs), strict=True
        )
        begun = stretches.first(laws, self.points[0])
        for k, (point, piece) in enumerate(
            zip(self.points[:-1], np.diff(self.points, axis=0), strict=True)
        ):
            begun = stretches.onward(begun, laws, k * self.spacing, point, piece, self.spacing)
        return self._replace(
            stretches=begun,
            static=np.array(static),
            kinetic=np.array(kinetic),
        )

    def at(self, depth: float) -> Vector:
        """Return the point at a depth along the track, shape (d,)."""
        return np.array(self.place(depth))

    def place(self, depth: float) -> list[float]:
        """Return the coordinates of the point at a depth along the track, m."""
        segment = self._segment(depth)
        beyond = depth - segment * self.spacing
        point, direction = self.points[segment].tolist(), self.directions[segment].tolist()
        return [x + beyond * e for x, e in zip(point, direction, strict=True)]

    def direction(self, depth: float) -> list[float]:
        """Return the unit direction of the segment at a depth, (d)."""
        direction: list[float] = self.directions[self._segment(depth)].tolist()
        return direction

    def _segment(self, depth: float) -> int:
        return int(min(max(depth / self.spacing, 0.0), self.laid - 1.000001))


def _rubbing(laws: Laws, point: Vector, piece: Vector) -> tuple[float, float]:
    """Return static and kinetic friction at a point, means over half a piece to either side.

    `piece` (1, d) is the one that ends there; at the entry there is none, (0, d).
    """
    if not laws.vary or not len(piece):
        limits = laws.at(point)
        return limits.static, limits.kinetic
    near = [laws.at(point + part * piece[0]) for part in _NEAR]
    return (
        sum(limits.static for limits in near) / len(near),
        sum(limits.kinetic for limits in near) / len(near),
    )


class TrackLayer:
    """Lays track points.

    Parameters
    ----------
    coupling : Coupling
    laws : Laws
        May be replaced while running.
    empty : ResponseTable
        Without rows.
    spacing : float
        h_t, m.
    near : NearField, optional
        What the mesh does not show about the needle.
    read : ndarray, shape (m, d), optional
        Where the readers of the table are, m.

    Attributes
    ----------
    prepares : bool
        Whether what comes after the next point is prepared beside the ticks.
    """

    prepares = True

    def __init__(
        self,
        coupling: Coupling,
        laws: Laws,
        empty: ResponseTable,
        spacing: float,
        near: NearField | None = None,
        read: Vector | None = None,
    ) -> None:
        self.coupling, self.laws, self.near = coupling, laws, near
        self._read = np.empty((0, 3)) if read is None else read
        none = np.empty(0)
        points = np.empty((0, empty.compliance.dimension))
        self._empty = Track(spacing, points, none, none, empty, points)

    def touch(self, entry: Vector, direction: Vector) -> Track:
        """Start with the cross-section at the entry, perpendicular to a unit direction."""
        row = self._empty.table.row(self.coupling.section(entry, direction))
        if self.near is not None:
            row = BeyondMesh(self.near.row(self._empty.points, entry, direction)).added(row)
        return self._empty._with(entry, self._empty.table.appended(row), self.laws)

    def foresee(self, track: Track, bevel: float) -> Track:
        """Find out what tells how the tissue is turned at the middle of the last segment.

        Parameters
        ----------
        track : Track
        bevel : float
            Bevel length, over which it is turned, m.
        """
        shares = self.coupling.turning(track.middle, track.directions[-1], bevel)
        return track._replace(ahead=NextPoint(shares))

    def gather(self, track: Track) -> Track:
        """Add up the footprint that was foreseen, or spread."""
        ahead = track.ahead
        assert ahead is not None and ahead.shares is not None
        footprint = added_up(ahead.shares)
        if ahead.point is None:
            ahead = ahead._replace(shares=None, turning=Reading(footprint))
        else:
            ahead = ahead._replace(shares=None, footprint=footprint)
        return track._replace(ahead=ahead)

    def read(self, track: Track) -> Track:
        """Find out how forces on the track turn the tissue there, one component more."""
        ahead = track.ahead
        assert ahead is not None and ahead.turning is not None
        return track._replace(ahead=ahead._replace(turning=track.table.read(ahead.turning)))

    def read_beyond_mesh(self, track: Track, bevel: float) -> Track:
        """Find out the same of what the mesh does not show."""
        ahead, near = track.ahead, self.near
        assert ahead is not None and near is not None
        turning = near.turning(track.points, track.middle, track.directions[-1], bevel)
        return track._replace(ahead=ahead._replace(near=turning))

    def aim(self, track: Track, heading: Vector, foresight: bool = False) -> Track:
        """Turn the last segment to where the tip cuts in its middle; foresee the next point.

        The last point was laid before the tip came near, where it was expected to cut. Its
        footprint stays there; the difference falls with the square of the spacing.

        Parameters
        ----------
        track : Track
        heading : ndarray, shape (d,)
            Unit direction of the cut, with the tip in the middle of the last segment. The
            midpoint rule makes the path converge with the square of the spacing, and what
            the held points do to the heading acts at once.
        foresight : bool
            Whether the path is expected to go on turning as it did.
        """
        if track.laid > 1:
            points, directions = track.points.copy(), track.directions.copy()
            points[-1] = points[-2] + track.spacing * heading
            directions[-1] = heading
            track = track._replace(points=points, directions=directions)
        point = track.points[-1] + track.spacing * heading
        if foresight and track.heading is not None:
            point += track.spacing * (heading - track.heading)
        ahead = track.ahead or NextPoint()
        return track._replace(ahead=ahead._replace(point=point, heading=heading))

    def spread(self, track: Track) -> Track:
        """Find out which nodes the next point touches."""
        ahead, last = track.ahead, track.points[-1]
        assert ahead is not None and ahead.point is not None
        shares = self.coupling.hat_shares(last, ahead.point, 2 * ahead.point - last)
        return track._replace(ahead=ahead._replace(shares=shares))

    def ask(self, track: Track, speed: float) -> Track:
        """Have prepared beside the ticks what comes after the next point.

        Find out which nodes that is, then ask for them.

        Parameters
        ----------
        track : Track
        speed : float
            At which the base goes along the needle, m/s.
        """
        ahead = track.ahead
        assert ahead is not None and ahead.point is not None
        compliance = track.table.compliance
        if ahead.onward is not None:
            compliance.expect(ahead.onward)
        elif self.prepares and track.laid % _EVERY == 0:
            direction = (ahead.point - track.points[-1]) / track.spacing
            least = _AT_LEAST[compliance.dimension]
            reach = max(_FORESEEN * track.spacing, least, min(_LEAD * speed, _FARTHEST))
            onward = self.coupling.ahead(ahead.point, direction, reach)
            return track._replace(ahead=ahead._replace(onward=onward))
        return track._replace(ahead=ahead._replace(onward=None, asked=True))

    def weigh(self, track: Track) -> Track:
        """Find out how the tissue answers to forces on the next point.

        One component more, then what the mesh does not show, of points and of readers, then
        all of its row.
        """
        ahead, table = track.ahead, track.table
        assert ahead is not None and ahead.footprint is not None
        footprint, known = ahead.footprint, ahead.columns
        if len(known) < table.compliance.dimension:
            rows = ahead.rows or table.rows.joined(footprint)
            known = (*known, table.column(footprint, len(known), rows))
            ahead = ahead._replace(rows=rows, columns=known)
        elif (more := self._beyond_mesh(track)) is not None:
            ahead = ahead._replace(beyond=more)
        else:
            row = table.row(footprint, known, ahead.rows)
            ahead = ahead._replace(row=ahead.beyond.added(row))
        return track._replace(ahead=ahead)

    def _beyond_mesh(self, track: Track) -> BeyondMesh | None:
        """Return more of what the mesh does not show of the next point; None where that is all."""
        ahead, near = track.ahead, self.near
        if near is None:
            return None
        assert ahead is not None and ahead.point is not None and ahead.heading is not None
        known = ahead.beyond
        if known.rows is None:
            return known._replace(rows=near.row(track.points, ahead.point, ahead.heading))
        if known.readers is None and len(self._read):
            last = track.points[-1]
            after = 2 * ahead.point - last
            return known._replace(readers=near.at(self._read, last, ahead.point, after))
        return None

    def append(self, track: Track, axes: Axes = ()) -> Track:
        """Add the row of the next point to the responses, once weighed.

        Parameters
        ----------
        track : Track
        axes : Axes, optional
            Of the base: what the balance will ask for along them is made beforehand.
        """
        ahead = track.ahead
        assert ahead is not None and ahead.row is not None
        table = track.table.appended(ahead.row)
        for number in range(len(axes) - 1):
            table.along(axes, number, len(axes) - 1)
        return track._replace(ahead=ahead._replace(table=table))

    def extend(self, track: Track) -> Track:
        """Lay the next point, once aimed."""
        if track.ahead is None or track.ahead.footprint is None:
            track = self.gather(self.spread(track))
        while track.ahead is None or track.ahead.row is None:
            track = self.weigh(track)
        if track.ahead.table is None:
            track = self.append(track)
        ahead = track.ahead
        assert ahead is not None and ahead.point is not None and ahead.table is not None
        return track._with(ahead.point, ahead.table, self.laws, ahead.heading)
