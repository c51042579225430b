# SPDX-License-Identifier: Apache-2.0
"""Tissue from files of tetrahedra: where points lie, what it answers, what is refused."""

import runpy
from pathlib import Path

import meshio
import numpy as np
import pytest
import skfem

from needle_sim_ros import BaseCommand, Scene, SceneError, Simulator
from needle_sim_ros.resources import find_mesh
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.mesh_file import read_tetrahedra
from needle_sim_ros.tissue.model import TissueModel

SIZE = np.array([0.08, 0.06, 0.05])
ORGAN = runpy.run_path(str(find_mesh("organ.msh").with_name("organ.py")))


def box(cells=(6, 6, 5)):
    """Points (n, 3) of a block below z = 0 and its tetrahedra (c, 4)."""
    lines = [np.linspace(-0.5, 0.5, count + 1) for count in cells]
    mesh = skfem.MeshTet.init_tensor(*lines)
    points = (mesh.p.T - [0, 0, 0.5]) * SIZE
    cells = mesh.t.T.copy()
    turned = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0
    cells[turned, 2:] = cells[turned, :1:-1]
    return points, cells


@pytest.fixture
def written(tmp_path):
    """Write a mesh and make the scene of a needle that comes down on it."""

    def make(points, cells, changes=None, name="block.vtu", **more):
        meshio.write(tmp_path / name, meshio.Mesh(points, [("tetra", cells)], **more))
        settings = {
            "name": "file",
            "dimension": 3,
            "tissue": {
                "size": SIZE.tolist(),
                "youngs_modulus": 15e3,
                "poisson_ratio": 0.45,
                "mesh": {
                    "file": str(tmp_path / name),
                    "fixed_boxes": [[-1, 1, -1, 1, -1, -0.0499]],
                },
            },
            "needle": {"length": 0.1, "radius": 1e-3, "youngs_modulus": 2e11},
            "solver": {"track_spacing": 8e-3},
            "base": {"position": [0.002, 0.001, 0.102]},
            "protocol": [{"duration": 8.0, "velocity": [0, 0, -4e-3]}],
        }
        return Scene.from_dict(settings, changes)

    return make


def test_points_are_found(written):
    found = read_tetrahedra(written(*box()))
    rng = np.random.default_rng(0)
    points = rng.uniform(SIZE * [-0.5, -0.5, -1], SIZE * [0.5, 0.5, 0], (500, 3))
    corners, middles = found.mesh.p.T, found.mesh.p[:, found.mesh.t].mean(axis=1).T
    for places in (points, corners, middles):
        cells, local, inside = found.locate(places)
        assert inside.all()
        again = found.mesh.mapping().F(local[:, :, None], tind=cells)[:, :, 0].T
        np.testing.assert_allclose(again, places, atol=1e-15)
    beside = np.array([[0, 0, 1e-5], [0.0401, 0, -0.01], [1.0, 2.0, 3.0]])
    cells, local, inside = found.locate(beside)
    assert not inside.any() and (local >= 0).all() and (local.sum(axis=0) <= 1 + 1e-12).all()


def test_sampling_reproduces_quadratics(written):
    model = TissueModel(written(*box()))
    points = np.random.default_rng(1).uniform(
        SIZE * [-0.5, -0.5, -1], SIZE * [0.5, 0.5, 0], (99, 3)
    )
    nodes, values, inside = model.shape_functions(points)

    def field(x, y, z):
        return 1 - 2 * x + 3 * x * y - 5 * z * z + y * z

    assert inside.all()
    sampled = (values * field(*model.coordinates)[nodes]).sum(axis=1)
    np.testing.assert_allclose(sampled, field(*points.T), atol=1e-13)


def test_stretched_block(written):
    """Uniaxial strain, exactly: K u of a linear field is its traction on the surface only."""
    model = TissueModel(written(*box()))
    moved = np.zeros((model.nodes, 3))
    moved[:, 2] = 0.01 * (model.coordinates[2] + SIZE[2])
    forces = model.stiffness @ moved.ravel()[model.free]
    nodal = np.zeros(3 * model.nodes)
    nodal[model.free] = forces
    modulus = 15e3 * (1 - 0.45) / ((1 + 0.45) * (1 - 2 * 0.45))
    top = np.isclose(model.coordinates[2], 0)
    pull = nodal.reshape(-1, 3)[top, 2].sum()
    assert pull == pytest.approx(0.01 * modulus * SIZE[0] * SIZE[1], rel=1e-10)
    inner = (np.abs(model.coordinates[:2]) < 0.49 * SIZE[:2, None]).all(axis=0) & ~top
    np.testing.assert_allclose(nodal.reshape(-1, 3)[inner], 0, atol=1e-10 * pull)


def test_it_does_not_lock(written):
    """Pressed at the top, nearly incompressible: against hexahedra that do not lock."""
    answers = {}
    for ratio in (0.3, 0.4999):
        for kind in ("tetrahedra", "hexahedra"):
            changes = {"tissue.poisson_ratio": ratio}
            if kind == "hexahedra":
                block = {
                    "size": SIZE.tolist(),
                    "youngs_modulus": 15e3,
                    "poisson_ratio": ratio,
                    "fixed": ["bottom"],
                    "mesh": {"uniform": True, "spacing_across": 0.01, "spacing_along": 0.01,
                             "element": "quad2"},
                }  # fmt: skip
                changes = {"tissue": block, "solver.track_spacing": 0.02}
            model = TissueModel(written(*box(), changes))
            near = model.coordinates[:2] / 0.02
            load = np.zeros((model.nodes, 3))
            load[:, 2] = np.exp(-(near**2).sum(axis=0)) * np.isclose(model.coordinates[2], 0)
            load /= load.sum()
            flat = load.ravel()[model.free]
            order = model.elimination_order
            answers[ratio, kind] = flat @ Factor(model.stiffness, order).solve(flat)
    ratio = {r: answers[r, "tetrahedra"] / answers[r, "hexahedra"] for r in (0.3, 0.4999)}
    assert ratio[0.3] == pytest.approx(1, abs=0.1)
    assert ratio[0.4999] == pytest.approx(ratio[0.3], abs=0.1)  # linear ones lose most of it


def organ_scene(tmp_path, changes=None, cells=(6, 6, 5)):
    organ = ORGAN["organ"]
    organ.__globals__["CELLS"] = cells
    meshio.write(tmp_path / "coarse.msh", organ(), file_format="gmsh22", binary=True)
    coarse = {
        "tissue.mesh.file": str(tmp_path / "coarse.msh"),
        "solver.track_spacing": 7e-3,
        **(changes or {}),
    }
    return Scene.load("organ", coarse)


def test_shipped_mesh_is_what_the_script_makes():
    organ = ORGAN["organ"]
    organ.__globals__["CELLS"] = (10, 10, 9)
    made, path = organ(), find_mesh("organ.msh")
    shipped = meshio.read(path)
    assert path.stat().st_size < 300_000
    np.testing.assert_array_equal(shipped.points, made.points)
    np.testing.assert_array_equal(shipped.cells_dict["tetra"], made.cells_dict["tetra"])


def test_organ(tmp_path):
    """Forces balance, the tumour resists more, the surface under the needle is at z = 0."""
    scene = organ_scene(tmp_path)
    sim = Simulator(scene)
    seen = [sim.step(BaseCommand(velocity=[0, 0, -5e-3]), 0.1) for _ in range(80)]
    last = seen[-1]
    np.testing.assert_allclose(last.contact_forces.sum(axis=0)[2], last.base_force[2], rtol=1e-9)
    assert last.insertion_depth > 0.02
    found = read_tetrahedra(scene)
    assert found.locate(np.array([[0, 0, -1e-9], [0, 0, 1e-4]]))[2].tolist() == [True, False]
    tumour = np.array([[0.006, 0, -0.03], [0, 0, -0.002]]).T
    assert found.tagged("tumour", tumour).tolist() == [True, False]
    cutting = {o.tip_force for o in seen if o.insertion_depth > 0.022}
    assert max(cutting) == pytest.approx(0.70, rel=1e-6)


def test_tags_stiffen(tmp_path):
    """A load on the tumour moves it less than on the same tissue without it."""
    soft = TissueModel(organ_scene(tmp_path, {"tissue.regions": []}))
    hard = TissueModel(organ_scene(tmp_path))
    load = soft.sampling(np.array([[0.006, 0.0, -0.03]])).toarray()[2]
    work = [load @ Factor(m.stiffness, m.elimination_order).solve(load) for m in (soft, hard)]
    assert work[1] < 0.6 * work[0]


def test_scale_and_offset(written):
    points, cells = box()
    lifted = 1e3 * (points + np.array([0.0, 0.0, 0.7]))  # mm
    plain = read_tetrahedra(written(points, cells))
    moved = read_tetrahedra(written(lifted, cells, {"tissue.mesh.scale": 1e-3}, "mm.vtu"))
    np.testing.assert_allclose(moved.mesh.p, plain.mesh.p, atol=1e-12)
    offset = {"tissue.mesh.scale": 1e-3, "tissue.mesh.offset": [0, 0, -0.7]}
    given = read_tetrahedra(written(lifted, cells, offset, "mm.vtu"))
    np.testing.assert_allclose(given.mesh.p, plain.mesh.p, atol=1e-12)
    offset["tissue.mesh.offset"] = [0, 0, -0.6]
    with pytest.raises(SceneError, match=r"at z = 0\.1 and must be at 0"):
        read_tetrahedra(written(lifted, cells, offset, "mm.vtu"))


def test_a_file_beside_the_scene(written, tmp_path, monkeypatch):
    scene = written(*box())
    text = scene.with_changes({"tissue.mesh.file": "block.vtu"}).to_yaml()
    (tmp_path / "scene.yaml").write_text(text)
    monkeypatch.chdir("/")
    assert Path(Scene.load(tmp_path / "scene.yaml").tissue.mesh.file) == tmp_path / "block.vtu"


def inverted(points, cells):
    cells = cells.copy()
    cells[7, :2] = cells[7, 1::-1]
    return points, cells


def torn(points, cells):
    more = points + np.array([0.2, 0, 0])
    return np.vstack([points, more]), np.vstack([cells, cells[:3] + len(points)])


def other_than_numbers(points, cells):
    points = points.copy()
    points[5] = np.nan
    return points, cells


@pytest.mark.parametrize(
    ("spoil", "changes", "words"),
    [
        (inverted, {}, r"1 tetrahedra are inverted or flat, the first is number 7 about x = "),
        (torn, {}, r"2 parts that do not touch, the smallest about x = "),
        (other_than_numbers, {}, "not finite"),
        (None, {"tissue.mesh.fixed_boxes": [[1, 2, 1, 2, 1, 2]]}, "holds no face"),
        (None, {"tissue.mesh.fixed_boxes": [[-1, 1, -1, 1, -1, 1]]}, "through a fixed face"),
        (None, {"tissue.mesh.fixed": ["bottom"]}, "no faces of .* are so named: none"),
        (None, {"tissue.size": [0.07, 0.06, 0.05]}, r"at least \[0\.08, 0\.06, 0\.05\]"),
        (None, {"tissue.size": [0.2, 0.06, 0.05], "base.position": [0.07, 0, 0.102]}, "beside"),
        (None, {"solver.track_spacing": 1e-3}, "over-constrains"),
        (None, {"tissue.regions": [{"name": "x", "shape": "tag"}]}, "no cells of .* tagged: none"),
        (
            None,
            {
                "tissue.size": [0.2, 0.06, 0.05],
                "tissue.regions": [
                    {"name": "x", "shape": "box", "center": [0.08, 0, -0.02],
                     "size": [0.01, 0.01, 0.01], "youngs_modulus": 1e3}
                ],
            },
            "holds no element",
        ),
    ],
)  # fmt: skip
def test_bad_meshes_are_refused(written, spoil, changes, words):
    points, cells = box() if spoil is None else spoil(*box())
    with pytest.raises(SceneError, match=words):
        read_tetrahedra(written(points, cells, changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tissue.mesh.fixed_boxes": []}, "or the tissue floats"),
        ({"tissue.mesh.fixed_boxes": [[0, 1]]}, "x from, to"),
        ({"tissue.fixed": ["bottom"]}, "faces of a block"),
        ({"tissue.mesh.element": "quad1"}, "must be tri2"),
        (
            {"tissue.mesh.file": None, "tissue.regions": [{"name": "x", "shape": "tag"}]},
            "mesh file",
        ),
        ({"dimension": 2, "tissue.size": [0.1, 0.1]}, "dimension 3"),
    ],
)
def test_bad_keys_are_refused(written, changes, words):
    with pytest.raises(SceneError, match=words):
        written(*box(), changes)


def test_missing_and_foreign_files(written, tmp_path):
    scene = written(*box())
    with pytest.raises(SceneError, match=r"no such file, nor one of this package \(organ.msh\)"):
        read_tetrahedra(scene.with_changes({"tissue.mesh.file": "missing.msh"}))
    for name, content in (("a.msh", b"hello"), ("b.txt", b"hello"), ("c.vtu", b"<xml")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SceneError, match=r"tissue\.mesh\.file.*meshio cannot read it"):
            read_tetrahedra(scene.with_changes({"tissue.mesh.file": str(tmp_path / name)}))
    surface = meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])])
    meshio.write(tmp_path / "surface.vtu", surface)
    with pytest.raises(SceneError, match="no tetrahedra"):
        read_tetrahedra(scene.with_changes({"tissue.mesh.file": str(tmp_path / "surface.vtu")}))
