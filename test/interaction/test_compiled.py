# SPDX-License-Identifier: Apache-2.0
"""The compiled step: what numpy finds, called where it should be, and safe with bad arrays."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Scene, Simulator
from needle_sim_ros.interaction import steady

pytestmark = pytest.mark.skipif(steady._steady is None, reason="built without a compiler")

QUANTITIES = ("tip_position", "base_force", "insertion_depth", "marker_positions")
ASKEW = {"base.orientation": [0.9961947, 0.0, 0.0871557, 0.0], "base.position": [0, 0, 0.14]}
COARSE_3D = {
    "tissue.size": [0.06, 0.06, 0.05],
    "tissue.mesh": {"spacing_across": 4e-3, "spacing_along": 4e-3, "band": 8e-3, "growth": 3.0},
    "solver.track_spacing": 4e-3,
    "markers": [[0.004, 0.002, -0.02]],
}


def motions(dt):
    """In, with a turn of speed, out aside, held, in again, and out."""
    for seconds, velocity in (
        (2.0, (0, 0, -10e-3)),
        (0.5, (0, 0, -4e-3)),
        (0.3, (5e-4, 0, 6e-3)),
        (0.2, (0, 0, 0)),
        (0.5, (0, 0, -10e-3)),
        (1.0, (0, 0, 10e-3)),
    ):
        for _ in range(round(seconds / dt)):
            yield BaseCommand(velocity=velocity)


class Counted:
    """The compiled module, with how often it answered."""

    def __init__(self, module):
        self._module, self.answered, self.passed = module, 0, 0

    def solve(self, *arguments):
        found = self._module.solve(*arguments)
        self.answered += found is not None
        self.passed += found is None
        return found


def run(scene, switch, monkeypatch):
    counted = Counted(steady._steady)
    with monkeypatch.context() as patch:
        patch.setenv(steady.SWITCH, switch)
        patch.setattr(steady, "_steady", counted)
        sim = Simulator(scene)
        ran = sim.rollout(motions(0.02), 0.02, QUANTITIES)
    return ran, counted, sim.ticks


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("gao2016", {}),
        ("gao2016", {"solver.dynamics": "newmark", "solver.modes": 20, "solver.time_step": 0.02}),
        ("gao2016", ASKEW),
        ("gao2016", {"needle.tip.bevel_angle": 0.1}),
        ("layered_inclusion", None),
        ("bevel_gelatin_22g", COARSE_3D),
    ],
    ids=["quasi-static", "modes", "askew", "long bevel", "layers", "3D"],
)
def test_it_finds_what_numpy_finds(name, changes, coarse_scene, monkeypatch):
    if name == "gao2016":
        scene = coarse_scene({"markers": [[0.005, 0.0, -0.01]], **changes})
    else:
        scene = Scene.load(name, changes)
    plain, untouched, _ = run(scene, "off", monkeypatch)
    compiled, counted, ticks = run(scene, "on", monkeypatch)
    assert untouched.answered == untouched.passed == 0
    assert counted.answered > 0.3 * ticks
    for quantity in QUANTITIES:
        scale = np.abs(plain[quantity]).max()
        np.testing.assert_allclose(
            compiled[quantity], plain[quantity], rtol=0, atol=1e-10 * scale, err_msg=quantity
        )


def test_it_is_the_same_to_the_bit_each_time(coarse_scene, monkeypatch):
    scene = coarse_scene()
    one, two = (run(scene, "on", monkeypatch)[0] for _ in range(2))
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(one[quantity], two[quantity])


@pytest.fixture(scope="module")
def arguments(coarse_scene):
    """What a step in mid-insertion asks."""
    asked = []

    class Kept:
        @staticmethod
        def solve(*arguments):
            asked[:] = arguments

    sim = Simulator(coarse_scene())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steady, "_steady", Kept)
        for _ in range(400):
            sim.step(BaseCommand(velocity=(0, 0, -5e-3)), 0.01)
    return asked


def test_it_answers_what_it_was_asked(arguments):
    tip, overlap = steady._steady.solve(*arguments)
    assert tip == pytest.approx(0.3)
    assert abs(overlap) < 1e-4


def test_it_leaves_to_python_what_does_not_slide(arguments):
    status = arguments[10].copy()
    for place in (0, len(status) // 2, -1):
        loose = status.copy()
        loose[place] = 0
        assert steady._steady.solve(*arguments[:10], loose, *arguments[11:]) is None
    back = (arguments[0][0], -arguments[0][1], *arguments[0][2:])
    assert steady._steady.solve(back, *arguments[1:]) is None
    fresh = np.zeros_like(arguments[8])  # not weakened yet
    assert steady._steady.solve(*arguments[:8], fresh, *arguments[9:]) is None


@pytest.mark.parametrize("number", range(24))
def test_an_array_that_does_not_fit_is_refused(arguments, number):
    changed = list(arguments)
    given = arguments[number]
    changed[number] = given[:-1] if isinstance(given, tuple) else np.zeros(1)
    if number == 15:  # as many points may vary as one likes, but no more than are held
        changed[number] = np.zeros(1000)
    with pytest.raises((ValueError, TypeError)):
        steady._steady.solve(*changed)
    with pytest.raises((ValueError, TypeError, BufferError)):
        changed[number] = None
        steady._steady.solve(*changed)


def test_too_few_arguments_are_refused(arguments):
    with pytest.raises(TypeError, match="24 arguments, not 3"):
        steady._steady.solve(*arguments[:3])


def test_a_switch_keeps_to_numpy(monkeypatch):
    monkeypatch.setenv(steady.SWITCH, "off")
    assert not steady.available()
    monkeypatch.delenv(steady.SWITCH)
    assert steady.available()
    monkeypatch.setattr(steady, "_steady", None)
    assert not steady.available()
