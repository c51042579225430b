# SPDX-License-Identifier: Apache-2.0
"""The compiled step: what numpy finds, called where it should be, and safe with bad arrays."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Scene, Simulator, compiled
from needle_sim_ros.interaction import compiled_balance

pytestmark = pytest.mark.skipif(
    compiled_balance._balance is None, reason="built without a compiler"
)

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
        self._module, self.slid, self.solved, self.passed = module, 0, 0, 0

    def slide(self, *arguments):
        found = self._module.slide(*arguments)
        self.slid += found[0]
        return found

    def bounded(self, *arguments):
        found = self._module.bounded(*arguments)
        self.solved += found is not None
        self.passed += found is None
        return found


def run(scene, switch, monkeypatch):
    counted = Counted(compiled_balance._balance)
    with monkeypatch.context() as patch:
        patch.setenv(compiled.SWITCH, switch)
        patch.setattr(compiled_balance, "_balance", counted)
        sim = Simulator(scene)
        ran = sim.rollout(motions(0.02), 0.02, QUANTITIES)
    return ran, counted, sim.statistics


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
    plain, untouched, before = run(scene, "off", monkeypatch)
    found, counted, after = run(scene, "on", monkeypatch)
    assert untouched.slid == untouched.solved == untouched.passed == 0
    assert counted.slid > 0.3 * after.ticks
    assert counted.solved > 0.02 * after.ticks
    assert counted.passed < 0.05 * after.ticks
    assert after.iterations == before.iterations
    assert after.worst_residual < 1e-9
    for quantity in QUANTITIES:
        scale = np.abs(plain[quantity]).max()
        np.testing.assert_allclose(
            found[quantity], plain[quantity], rtol=0, atol=1e-10 * scale, err_msg=quantity
        )


def test_it_is_the_same_to_the_bit_each_time(coarse_scene, monkeypatch):
    scene = coarse_scene()
    one, two = (run(scene, "on", monkeypatch)[0] for _ in range(2))
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(one[quantity], two[quantity])


@pytest.fixture(scope="module", params=["slide", "bounded"])
def call(request, coarse_scene):
    """A compiled function, and what it was asked in mid-insertion or as the needle turned back."""
    asked = []

    def kept(*arguments):
        asked[:] = arguments
        return found(*arguments)

    found = getattr(compiled_balance._balance, request.param)
    sim = Simulator(coarse_scene())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled_balance._balance, request.param, kept)
        for _ in range(400):
            sim.step(BaseCommand(velocity=(0, 0, -5e-3)), 0.01)
        if request.param == "bounded":
            for _ in range(3):
                sim.step(BaseCommand(velocity=(0, 0, 2e-3)), 0.01)
    return found, asked


def test_it_answers_what_it_was_asked(call):
    solve, arguments = call
    *_, forces, after = arguments[10:15]
    answers = [solve(*arguments) for _ in range(2)]
    assert answers[0] == answers[1]
    if solve.__name__ == "slide":
        holds, reach, tip, overlap, lack, state, solves = answers[0]
        assert (holds, lack, state, solves) == (True, 0.0, 1, 1)
        assert tip == pytest.approx(0.3)
        assert abs(overlap) < 1e-4
        assert reach > 0
    else:
        tip, *_, residual, solves = answers[0]
        assert 0 <= tip <= 0.3
        assert residual < 1e-9
        assert 1 <= solves <= 10
    assert np.isfinite(forces).all()
    assert np.isfinite(after).all()


def test_a_guess_that_leaves_something_free_is_not_tried(coarse_scene, monkeypatch):
    """Nothing is factorised for it either."""
    seen = []
    slide = compiled_balance._balance.slide

    def kept(*arguments):
        found = slide(*arguments)
        seen.append((arguments[8][:-1].all(), arguments[20] is not None, found[0]))
        return found

    monkeypatch.setattr(compiled_balance._balance, "slide", kept)
    sim = Simulator(coarse_scene())
    for velocity in (-5e-3, 2e-3):
        for _ in range(300 if velocity < 0 else 20):
            sim.step(BaseCommand(velocity=(0, 0, velocity)), 0.01)
    assert {tried for bound, tried, _ in seen if bound} == {True}
    assert {(tried, holds) for bound, tried, holds in seen if not bound} == {(False, False)}


def unfit(arguments):
    """Arguments of which one does not fit, with its number."""
    for number, given in enumerate(arguments):
        changed = list(arguments)
        changed[number] = given[:-1] if isinstance(given, tuple) else np.zeros(1)
        if number == 22:  # as many points may vary as one likes, but no more than are held
            changed[number] = np.zeros(1000)
        yield number, changed
        if number != 20:  # without a factor nothing is tried
            yield number, [*changed[:number], None, *changed[number + 1 :]]


def test_an_array_that_does_not_fit_is_refused(call):
    solve, arguments = call
    for number, changed in unfit(arguments):
        with pytest.raises((ValueError, TypeError, BufferError)):
            solve(*changed)
            pytest.fail(f"argument {number} was taken")


def test_too_few_arguments_are_refused(call):
    solve, arguments = call
    with pytest.raises(TypeError, match=f"{len(arguments)} arguments, not 3"):
        solve(*arguments[:3])


@pytest.mark.parametrize("guess", [1, 0, -1])
@pytest.mark.parametrize("push", [-1e-3, 0.0, 1e-5, 2e-3])
def test_the_tip_comes_to_the_same_whatever_was_guessed(coarse_scene, monkeypatch, guess, push):
    """With the needle a little back, the tip bears nothing, a part, or all it can."""
    sim = Simulator(coarse_scene())
    for _ in range(400):
        sim.step(BaseCommand(velocity=(0, 0, -5e-3)), 0.01)
    ways = {}
    for compiled_way in (True, False):
        balance = sim._contact_laws._balance
        with monkeypatch.context() as patch:
            solve = balance.inserted
            found = []

            def kept(
                track,
                step,
                moved,
                memory,
                status,
                depth,
                limit,
                solve=solve,
                found=found,
            ):
                status = np.append(status[:-1], np.int8(guess))
                found.append(solve(track, step, moved, memory, status, depth + push, limit))
                return solve(track, step, moved, memory, status, depth, limit)

            patch.setattr(balance, "inserted", kept)
            if not compiled_way:
                patch.setattr(balance, "_compiled", None)
            before = sim.snapshot()
            sim.step(BaseCommand(velocity=(0, 0, -5e-3)), 0.01)
            sim.restore(before)
        ways[compiled_way] = found[0]
    one, other = ways[True], ways[False]
    assert one.status[-1] == other.status[-1]
    for name in ("tip", "overlap", "lack"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-9, abs=1e-15)
    np.testing.assert_allclose(one.forces, other.forces, rtol=0, atol=1e-12)


def test_a_switch_keeps_to_numpy(monkeypatch):
    monkeypatch.setenv(compiled.SWITCH, "off")
    assert not compiled_balance.available()
    monkeypatch.delenv(compiled.SWITCH)
    assert compiled_balance.available()
    monkeypatch.setattr(compiled_balance, "_balance", None)
    assert not compiled_balance.available()
