# SPDX-License-Identifier: Apache-2.0
"""Prepared responses on disk: the same bits, no factorisation; damage is seen and mended."""

import os

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Scene, Simulator
from needle_sim_ros.tissue import build
from needle_sim_ros.tissue.cache import Cache

SOLID = {
    "tissue.mesh.spacing_across": 8e-3,
    "tissue.mesh.spacing_along": 16e-3,
    "tissue.mesh.growth": 4.0,
    "solver.track_spacing": 16e-3,
    "tissue.regions": [],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of its own that keeps whatever is prepared, however quickly."""
    monkeypatch.setenv("NEEDLE_SIM_CACHE", str(tmp_path))
    monkeypatch.setattr(build, "_WORTH_A_FILE", 0.0)
    return tmp_path


@pytest.fixture
def scene(request, coarse_scene):
    """The plane with reduced dynamics, and the block."""
    if request.param == 2:
        return coarse_scene({"solver.dynamics": "newmark", "solver.modes": 10})
    return Scene.load("layered_inclusion_3d", SOLID)


def driven(sim, aside=0.0):
    """Everything that an insertion shows, which may go beside the plan."""
    seen = []
    for tick in range(11):
        across = aside if tick == 0 else 0.0
        seen.append(sim.step(BaseCommand(velocity=[across, 0, -8e-3]), 0.4))
    return np.array([[*o.tip_position, *o.base_force, *o.marker_displacements.flat] for o in seen])


@pytest.mark.parametrize("scene", [2, 3], indirect=True)
@pytest.mark.parametrize("aside", [0.0, 0.05])
def test_same_bits_with_and_without(scene, folder, monkeypatch, aside):
    first = Simulator(scene)
    assert not first.preparation.cached and len(list(folder.iterdir())) == 1
    again = Simulator(scene)
    assert again.preparation.cached and not again._factor.factorised
    monkeypatch.setenv("NEEDLE_SIM_CACHE", "off")
    without = Simulator(scene)
    assert not without.preparation.cached
    results = [driven(sim, aside) for sim in (first, again, without)]
    np.testing.assert_array_equal(results[1], results[0])
    np.testing.assert_array_equal(results[2], results[0])
    assert again._factor.factorised == bool(aside)  # only what left the plan was solved for


@pytest.fixture
def solid(folder):
    return Scene.load("layered_inclusion_3d", SOLID)


@pytest.mark.parametrize(
    "changes",
    [
        {"tissue.youngs_modulus": 16e3},
        {"tissue.fixed": ["bottom"]},
        {"markers": [[0.0, 0.01, -0.02]]},
        {"solver.factorization": "superlu", "tissue.density": 900.0, "tissue.poisson_ratio": 0.3},
    ],
)
def test_other_scenes_are_other_files(solid, folder, changes):
    Simulator(solid)
    assert not Simulator(solid.with_changes(changes)).preparation.cached
    assert len(list(folder.iterdir())) == 2


def test_laws_do_not_matter(solid):
    """What the tissue's matrix does not know of finds the same file."""
    Simulator(solid)
    assert Simulator(solid.with_changes({"interaction.cutting.force": 0.1})).preparation.cached


@pytest.mark.parametrize("damage", ["cut", "flipped", "foreign", "empty"])
def test_damaged_files_are_replaced(solid, folder, caplog, damage):
    whole = driven(Simulator(solid))
    (path,) = folder.iterdir()
    data = bytearray(path.read_bytes())
    if damage == "flipped":
        data[len(data) // 2] ^= 1
    path.write_bytes({"cut": data[:-1000], "foreign": b"hello", "empty": b""}.get(damage, data))
    mended = Simulator(solid)
    assert not mended.preparation.cached
    assert str(path) in caplog.text and "damaged" in caplog.text
    np.testing.assert_array_equal(driven(mended), whole)
    assert Simulator(solid).preparation.cached


def test_a_file_under_another_name_is_foreign(solid, folder, caplog):
    """Its digest covers the key: numbers of another scene are never taken for this one's."""
    Simulator(solid)
    (mine,) = folder.iterdir()
    other = solid.with_changes({"tissue.youngs_modulus": 16e3})
    Simulator(other)
    (theirs,) = set(folder.iterdir()) - {mine}
    theirs.write_bytes(mine.read_bytes())
    assert not Simulator(other).preparation.cached
    assert "wrong digest" in caplog.text


def arrays(size):
    return {name: np.ones((size, 1)) for name in ("blocks", "read", "eigenvalues", "shapes")}


def test_the_oldest_are_evicted(tmp_path):
    cache = Cache(tmp_path, limit=110_000)
    for number in range(4):
        cache.store(f"key{number}", arrays(1000))
        stamp = 1_000_000_000 + number
        os.utime(tmp_path / f"key{number}.npz", (stamp, stamp))
        if number == 2:
            assert cache.load("key0") is not None  # used now
    assert cache.load("key1") is None
    assert all(cache.load(f"key{number}") is not None for number in (0, 2, 3))


def test_nothing_larger_than_the_limit_is_kept(tmp_path):
    Cache(tmp_path, limit=1000).store("key", arrays(1000))
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path, caplog):
    (tmp_path / "file").write_text("")
    Cache(tmp_path / "file" / "below").store("key", arrays(10))
    assert "nothing is cached" in caplog.text


def test_where_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("NEEDLE_SIM_CACHE", "off")
    assert Cache.of_environment().folder is None
    monkeypatch.delenv("NEEDLE_SIM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert Cache.of_environment().folder == tmp_path / "needle_sim_ros"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the standard has it ignored
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert Cache.of_environment().folder == tmp_path / "home/.cache/needle_sim_ros"
