# SPDX-License-Identifier: Apache-2.0
"""Order in which the unknowns of a box of hexahedra are eliminated: nested dissection.

A plane of nodes splits the block into halves that do not touch; it is eliminated after
both, and each half is split again. On a 3D grid the factor then has half the entries that
the minimum degree ordering leaves, and is computed several times faster.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.intp]

_SMALLEST = 12


def nested_dissection(places: Index) -> Index:
    """Return an elimination order of the nodes of a grid.

    Parameters
    ----------
    places : ndarray of int, shape (d, n)
        Number of the grid line of each node, doubled: nodes within cells have odd numbers.

    Returns
    -------
    ndarray of int, shape (n,)
        The nodes, the first to be eliminated first.
    """
    parts: list[Index] = []
    _dissect(places, np.arange(places.shape[1]), parts)
    return np.concatenate(parts)


def _dissect(places: Index, nodes: Index, parts: list[Index]) -> None:
    if len(nodes) <= _SMALLEST:
        parts.append(nodes)
        return
    inside = [np.unique(row[row % 2 == 0])[1:-1] for row in places[:, nodes]]
    axis = int(np.argmax([len(lines) for lines in inside]))
    lines = inside[axis]
    if len(lines) == 0:
        parts.append(nodes)
        return
    at = places[axis, nodes]
    middle = lines[np.argmin(np.abs(lines - np.median(at)))]
    _dissect(places, nodes[at < middle], parts)
    _dissect(places, nodes[at > middle], parts)
    parts.append(nodes[at == middle])
