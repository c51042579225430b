# SPDX-License-Identifier: Apache-2.0
"""Nested dissection by coordinates: an elimination order with little fill on large meshes.

The nodes are halved again and again across the direction with the most mesh lines; the
nodes on the cut are eliminated after both halves, which then never fill into each other
(George 1973). Minimum degree is better on small and graded meshes, and far worse on the
large uniform grids that this is for.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.mesh import Index

_LEAF = 24


def nested_dissection(graph: sp.csr_array, places: Vector) -> Index:
    """Return the order in which to eliminate nodes.

    Parameters
    ----------
    graph : csr_array, shape (n, n)
        Its pattern joins the nodes that share an element; symmetric.
    places : ndarray, shape (d, n)
        Positions of the nodes, m.

    Returns
    -------
    ndarray of int, shape (n,)
        Each node once.
    """
    lines = np.array([_ranks(x) for x in places])
    lower = np.zeros(graph.shape[0], dtype=bool)
    backwards: list[Index] = []
    open_parts: list[Index] = [np.arange(graph.shape[0])]
    while open_parts:
        nodes = open_parts.pop()
        at = lines[:, nodes]
        spans = at.max(axis=1) - at.min(axis=1)
        along = at[int(np.argmax(spans))]
        below = along < np.median(along)
        if len(nodes) <= _LEAF or not below.any():
            backwards.append(nodes)
            continue
        low, high = nodes[below], nodes[~below]
        lower[low] = True
        cut = _touches(graph, high, lower)
        lower[low] = False
        backwards.append(high[cut])
        open_parts += [low, high[~cut]] if not cut.all() else [low]
    return np.concatenate(backwards[::-1])


def _ranks(x: Vector) -> NDArray[np.int64]:
    """Number the mesh lines that nodes lie on; in a graded mesh they count, not lengths."""
    span = float(np.ptp(x)) or 1.0
    return np.asarray(np.unique(np.round(x / span, 9), return_inverse=True)[1])


def _touches(graph: sp.csr_array, nodes: Index, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the nodes have a marked neighbour."""
    starts, counts = graph.indptr[nodes], np.diff(graph.indptr)[nodes]
    first = np.cumsum(counts) - counts
    neighbours = graph.indices[np.repeat(starts - first, counts) + np.arange(counts.sum())]
    return np.asarray(np.logical_or.reduceat(marked[neighbours], first))


def unknowns_order(matrix: sp.csr_array, places: Vector) -> Index:
    """Order the unknowns of a matrix so that those at one place stay together.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
    places : ndarray, shape (d, n)
        Where each unknown is, m; unknowns of one place follow each other.
    """
    new = np.concatenate([[True], (np.diff(places, axis=1) != 0).any(axis=0)])
    node = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    rows = matrix[first]
    ones = np.ones(rows.nnz, dtype=np.int8)
    graph = sp.csr_array((ones, node[rows.indices], rows.indptr), shape=(len(first),) * 2)
    order = nested_dissection(graph, places[:, first])
    counts = np.diff(np.append(first, len(node)))[order]
    begin = np.cumsum(counts) - counts
    return np.repeat(first[order] - begin, counts) + np.arange(len(node))
