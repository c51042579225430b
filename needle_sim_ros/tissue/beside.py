# SPDX-License-Identifier: Apache-2.0
"""Prepares what lies about the planned path in the worker, beside the ticks.

The set-up computes what the plan needs. A needle that is steered elsewhere finds its responses
there once this has passed; until then a tick may have to wait for a solve, which is counted.
"""

from __future__ import annotations

import weakref

from needle_sim_ros.tissue.compliance import NodalCompliance
from needle_sim_ros.tissue.mesh import Index


class Beside:
    """Tiles of nodes to prepare, the likeliest first; nothing is done before :meth:`start`.

    Parameters
    ----------
    compliance : NodalCompliance
        Prepared for the plan.
    groups : list of ndarray of int
        Nodes, the likeliest first.

    Attributes
    ----------
    total, done : int
        Tiles.
    """

    def __init__(self, compliance: NodalCompliance, groups: list[Index]) -> None:
        self._compliance = compliance
        self._tiles = compliance.set_aside(groups)
        self.total, self.done = len(self._tiles), 0
        self._started = False

    @property
    def share(self) -> float:
        """What part is prepared."""
        return self.done / self.total if self.total else 1.0

    def start(self) -> None:
        """Begin, or do nothing where it has begun."""
        if self.total and not self._started:
            self._started = True
            self._compliance.worker().submit(_onward, weakref.ref(self))

    def advance(self) -> None:
        """Prepare the next tile."""
        self._compliance.prepare_tile(self._tiles[self.done])
        self.done += 1
        if self.done < self.total:
            # one by one: what a tick asks for meanwhile waits for one tile at most
            self._compliance.worker().submit(_onward, weakref.ref(self))


def _onward(beside: weakref.ref[Beside]) -> None:
    """Prepare a tile for whoever still wants it."""
    here = beside()
    if here is not None:
        here.advance()
