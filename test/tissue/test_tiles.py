# SPDX-License-Identifier: Apache-2.0
"""Tiles: every node is in one, neighbours share theirs, deeper ones have higher numbers."""

import numpy as np
import pytest

from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.tiles import Tiles

SIZE = (6e-3, 8e-3)


@pytest.fixture(scope="module")
def model(coarse_scene):
    return TissueModel(coarse_scene())


@pytest.fixture(scope="module")
def tiles(model):
    return Tiles(model, SIZE, np.array([0.0, 0.0]))


def test_every_node_is_in_one_tile(model, tiles):
    members = [tiles.members(tile) for tile in range(tiles.count)]
    assert (np.sort(np.concatenate(members)) == np.arange(model.nodes)).all()
    assert all((tiles.of[nodes] == tile).all() for tile, nodes in enumerate(members))


def test_members_are_neighbours(model, tiles):
    for tile in range(tiles.count):
        extent = np.ptp(model.coordinates[:, tiles.members(tile)], axis=1)
        assert (extent <= np.array(SIZE) * (1 + 1e-9)).all()


def test_deeper_tiles_have_higher_numbers(model, tiles):
    lowest = [model.coordinates[-1, tiles.members(tile)].min() for tile in range(tiles.count)]
    layers = np.floor(np.array(lowest) / SIZE[-1] + 0.5)
    assert (np.diff(layers) <= 0).all()


def test_whole_holds_what_was_asked_for_and_nothing_of_other_tiles(tiles):
    nodes = np.array([3, 40, 41])
    whole = tiles.whole(nodes)
    assert np.isin(nodes, whole).all()
    assert (np.unique(tiles.of[whole]) == tiles.touched(nodes)).all()
    assert tiles.whole(nodes[:0]).size == 0
