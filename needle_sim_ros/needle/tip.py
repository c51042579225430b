# SPDX-License-Identifier: Apache-2.0
"""The bevelled tip: where it turns the cut to, and over which length it presses."""

from __future__ import annotations

import math

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Needle


def bevel_length(needle: Needle) -> float:
    """Return the length of the bevel along the axis, 2 r / tan(bevel angle), m."""
    return 2 * needle.radius / math.tan(needle.tip.bevel_angle)


def spread_length(needle: Needle) -> float:
    """Return over which length the tip presses and the tissue feels it, m.

    That of the bevel; of a blunt tip no less than the radius.
    """
    return max(bevel_length(needle), needle.radius)


def cutting_direction(needle: Needle, axial: Vector, lateral: Vector, slope: Vector) -> Vector:
    """Return the direction in space in which the tip cuts.

    The needle's tangent at the tip, turned by the deviation angle about the bevel axis.

    Parameters
    ----------
    needle : Needle
    axial : ndarray, shape (d,)
        Base z.
    lateral : ndarray, shape (d - 1, d)
        Base x (and y).
    slope : ndarray, shape (d - 1,)
        Slopes of the deflected needle at the tip.

    Returns
    -------
    ndarray, shape (d,)
        Unit vector.
    """
    tip = needle.tip
    bevel = np.array([math.cos(tip.roll), math.sin(tip.roll)])[: len(lateral)]
    direction = axial + (slope + math.tan(tip.deviation_angle) * bevel) @ lateral
    return np.asarray(direction / math.sqrt(float(direction @ direction)))
