# SPDX-License-Identifier: Apache-2.0
"""Libraries that factorise: the same answers, the trailing block, what is chosen."""

import importlib.util
from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest
import scipy.sparse as sp

from needle_sim_ros import BaseCommand, Scene, SceneError, Simulator
from needle_sim_ros.errors import SolverError
from needle_sim_ros.tissue import libraries
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.libraries import choose
from needle_sim_ros.tissue.superlu import SuperLU

PARDISO = pytest.param(
    "pardiso",
    marks=pytest.mark.skipif(
        importlib.util.find_spec("pypardiso") is None, reason="pypardiso is not installed"
    ),
)


def laplacian(size=40):
    """Of a grid of size x size points, held at the rim; symmetric positive definite."""
    line = sp.diags([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(size, size))
    return sp.csr_array(sp.kron(line, sp.eye(size)) + sp.kron(sp.eye(size), line))


@pytest.fixture(scope="module")
def matrix():
    return laplacian()


@pytest.fixture(scope="module")
def order(matrix):
    return np.random.default_rng(1).permutation(matrix.shape[0])


LAST = np.array([3, 17, 18, 55, 800, 801, 1001, 1599])


@pytest.mark.parametrize("library", ["superlu", PARDISO])
def test_answers(matrix, order, library):
    right = np.random.default_rng(0).normal(size=(matrix.shape[0], 5))
    expected = sp.linalg.spsolve(sp.csc_matrix(matrix), right)
    factor = Factor(matrix, order, choose(library))
    np.testing.assert_allclose(factor.solve(right), expected, atol=1e-12)
    np.testing.assert_allclose(factor.solve(right[:, 2]), expected[:, 2], atol=1e-12)
    assert factor.solves == 6


@pytest.mark.parametrize("library", ["superlu", PARDISO])
def test_block_of_the_inverse(matrix, order, library):
    """The trailing part of the factor against dense inversion; symmetric to the bit."""
    factor = Factor(matrix, order, choose(library))
    factor.put_last(LAST)
    block = factor.inverse()
    expected = np.linalg.inv(matrix.toarray())[np.ix_(LAST, LAST)]
    np.testing.assert_allclose(block, expected, rtol=1e-11)
    np.testing.assert_array_equal(block, block.T)
    unit = np.zeros(matrix.shape[0])
    unit[LAST[4]] = 1.0
    np.testing.assert_allclose(factor.solve(unit)[LAST], block[:, 4], rtol=1e-11)


@pytest.mark.parametrize("library", ["superlu", PARDISO])
def test_block_of_all_unknowns(library):
    matrix = laplacian(6)
    factor = Factor(matrix, np.arange(36), choose(library))
    factor.put_last(np.arange(36))
    np.testing.assert_allclose(factor.inverse(), np.linalg.inv(matrix.toarray()), rtol=1e-11)


def test_block_where_the_library_orders(matrix):
    """Without an order the wanted unknowns do not come last: unit solves then."""
    block = SuperLU(matrix, None, LAST).inverse()
    expected = np.linalg.inv(matrix.toarray())[np.ix_(LAST, LAST)]
    np.testing.assert_allclose(block, expected, rtol=1e-11)


@pytest.mark.parametrize("library", ["superlu", PARDISO])
def test_same_bits_each_time(matrix, order, library):
    blocks = []
    for _ in range(2):
        factor = Factor(matrix, order, choose(library))
        factor.put_last(LAST)
        blocks.append(factor.inverse())
    np.testing.assert_array_equal(*blocks)


def test_indefinite_matrices_are_refused(matrix, order):
    shifted = sp.csr_array(matrix - 4.0 * sp.csr_array(sp.eye(matrix.shape[0])))
    factor = Factor(shifted, order)
    factor.put_last(LAST)
    with pytest.raises(SolverError, match="not positive definite"):
        factor.inverse()


def test_factorises_when_asked(matrix, order):
    factor = Factor(matrix, order)
    assert not factor.factorised
    factor.solve(np.ones(matrix.shape[0]))
    assert factor.factorised
    with pytest.raises(RuntimeError):
        factor.put_last(LAST)


def test_the_fastest_installed_is_taken(monkeypatch):
    def only(*names):
        def version(package):
            if package not in names:
                raise PackageNotFoundError(package)
            return "1.2.3"

        monkeypatch.setattr(libraries, "version", version)

    only("scipy", "pypardiso")
    assert str(choose()) == "pardiso (pypardiso 1.2.3)"
    assert choose(dimension=2).name == "superlu"
    assert choose("superlu").name == "superlu"
    only("scipy")
    assert choose().name == "superlu" and "[fast]" in choose().reason
    with pytest.raises(SceneError, match=r"pypardiso is not installed; here are auto, superlu"):
        choose("pardiso")


@pytest.fixture(scope="module")
def ends():
    """Tip position after an insertion with a library, in 3D: on the plan, then off it."""

    def make(library):
        scene = Scene.load("layered_inclusion_3d", {**COARSE_3D, "solver.factorization": library})
        sim = Simulator(scene)
        assert sim.preparation.library.name == library
        for _ in range(100):
            sim.step(BaseCommand(velocity=[0, 0, -4e-3]), 0.1)
        sim.step(BaseCommand(velocity=[0.02, 0.02, 0]), 0.5)
        for _ in range(20):
            last = sim.step(BaseCommand(velocity=[0, 0, -4e-3]), 0.1)
        return np.concatenate([last.tip_position, last.base_force, *last.marker_displacements])

    return make


COARSE_3D = {
    "tissue.mesh.spacing_across": 8e-3,
    "tissue.mesh.spacing_along": 16e-3,
    "solver.track_spacing": 16e-3,
}


@pytest.mark.parametrize("library", [PARDISO])
def test_libraries_agree_on_a_scene(ends, library):
    np.testing.assert_allclose(ends(library), ends("superlu"), rtol=1e-8, atol=1e-12)
