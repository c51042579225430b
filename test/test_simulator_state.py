# SPDX-License-Identifier: Apache-2.0
"""Repetition to the bit, snapshots, branching, rollouts, changed laws, statistics."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, CommandError, SceneError, Simulator
from needle_sim_ros.interaction.process import Process

DOWN = BaseCommand(velocity=[0, 0, -3e-3])
UP = BaseCommand(velocity=[0, 0, 3e-3])
LEFT = BaseCommand(velocity=[-3e-3, 0, -3e-3])
RIGHT = BaseCommand(velocity=[3e-3, 0, -3e-3])
TURN = BaseCommand(velocity=[0, 0, -2e-3], angular_velocity=[0, 0.03, 0])
HOLD = BaseCommand()
WAYS = {
    "quasi_static": {"needle.tip.deviation_angle": 0.3},
    "reduced": {"solver.dynamics": "newmark", "solver.modes": 20, "solver.time_step": 0.05},
    "newmark": {"solver.dynamics": "newmark", "solver.time_step": 0.05},
}
DT = 0.05

MEMBERS = (
    "time", "insertion_depth", "tip_position", "tip_deflection", "base_position",
    "base_orientation", "base_force", "base_torque", "friction_force", "tip_force",
    "marker_positions", "marker_displacements", "contact_points", "contact_forces",
    "needle_points", "tip_slope",
)  # fmt: skip


@pytest.fixture(params=WAYS)
def changes(request):
    return {**WAYS[request.param], "markers": [[-0.003, 0, -0.02], [0.02, 0, -0.05]]}


def step(sim, *commands):
    """One tick for each command; what it showed, as bytes."""
    return [shown(sim.step(command, DT)) for command in commands]


def shown(observation):
    values = [np.asarray(getattr(observation, name), dtype=float) for name in MEMBERS]
    return observation.process, *(value.tobytes() for value in values)


def trip(*lengths):
    down, aside, hold, up, turn = lengths
    return [DOWN] * down + [RIGHT] * aside + [HOLD] * hold + [UP] * up + [TURN] * turn


def test_the_same_scene_and_commands_give_the_same_bits(coarse_scene, changes):
    commands = trip(120, 20, 5, 20, 30)
    one, other = (step(Simulator(coarse_scene(changes)), *commands) for _ in range(2))
    assert one == other


def test_reset_is_a_fresh_start(coarse_scene, changes):
    commands = trip(100, 20, 5, 10, 0)
    sim = Simulator(coarse_scene(changes))
    fresh = shown(sim.observe())
    first = step(sim, *commands)
    assert shown(sim.reset()) == fresh
    assert (sim.time, sim.ticks) == (0.0, 0)
    assert step(sim, *commands) == first


def test_a_snapshot_is_exact(coarse_scene, changes):
    sim = Simulator(coarse_scene(changes))
    step(sim, *trip(110, 5, 0, 0, 0))
    kept, seen = sim.snapshot(), shown(sim.observe())
    first = step(sim, *trip(20, 10, 3, 10, 5))
    sim.restore(kept)
    assert shown(sim.observe()) == seen
    assert step(sim, *trip(20, 10, 3, 10, 5)) == first


def test_branches_do_not_know_of_each_other(coarse_scene, changes):
    """From one snapshot to both sides, off the planned path, the track laid anew each time:
    each branch is to the bit what a simulator shows that never saw the other."""
    trunk, left, right = [DOWN] * 110, [LEFT] * 60, [RIGHT] * 60
    sim = Simulator(coarse_scene(changes))
    step(sim, *trunk)
    fork = sim.snapshot()
    seen = {"left": step(sim, *left)}
    sim.restore(fork)
    seen["right"] = step(sim, *right)
    sim.restore(fork)
    seen["left again"] = step(sim, *left)
    assert seen["left"] == seen["left again"]
    assert seen["left"] != seen["right"]
    for name, branch in (("left", left), ("right", right)):
        alone = Simulator(coarse_scene(changes))
        step(alone, *trunk)
        assert step(alone, *branch) == seen[name]


def test_old_snapshots_stay_what_they_were(coarse_scene, changes):
    """Snapshots along a run, restored in another order, each go on as the run did."""
    sim = Simulator(coarse_scene(changes))
    commands = trip(110, 10, 2, 10, 10)
    kept, seen = [], []
    for command in commands:
        kept.append(sim.snapshot())
        seen += step(sim, command)
    for at in (130, 40, 115, 0, 85):
        sim.restore(kept[at])
        assert step(sim, *commands[at : at + 6]) == seen[at : at + 6]


def test_restore_wants_a_snapshot(simulator):
    sim = simulator()
    with pytest.raises(CommandError, match="snapshot"):
        sim.restore({"time": 0.0})


def test_a_rollout_is_stepping(coarse_scene, changes):
    commands = trip(100, 10, 2, 5, 0)
    one, other = (Simulator(coarse_scene(changes)) for _ in range(2))
    found = one.rollout(commands, DT, (*MEMBERS[:9], "marker_displacements"))
    observations = [other.step(command, DT) for command in commands]
    for name, series in found.items():
        expected = np.array([getattr(o, name) for o in observations])
        assert series.shape == expected.shape
        assert series.tobytes() == expected.tobytes(), name
    assert one.time == other.time and one.ticks == len(commands)


def test_a_rollout_returns_what_is_wanted_only(simulator):
    assert set(simulator().rollout([DOWN] * 3, DT)) == {
        "time", "insertion_depth", "tip_position", "base_force",
    }  # fmt: skip
    assert set(simulator().rollout([DOWN] * 3, DT, ["tip_force"])) == {"tip_force"}
    for unknown in ("nonsense", "_contact"):
        with pytest.raises(CommandError, match=unknown):
            simulator().rollout([DOWN], DT, [unknown])


def test_changed_friction_acts_at_once(coarse_scene):
    """Kinetic 14 to 7 N/m while sliding 25 mm deep: half the friction at the next tick."""
    sim = Simulator(coarse_scene({"needle.tip.deviation_angle": 0.0}))
    step(sim, *[DOWN] * 240)
    before = sim.observe()
    sim.change_interaction({"friction.kinetic": 7.0, "friction.static": 7.0})
    assert sim.scene.interaction.friction.kinetic == 7.0
    after = sim.step(DOWN, DT)
    assert after.friction_force == pytest.approx(7.0 * after.insertion_depth, abs=1e-3)
    assert before.friction_force == pytest.approx(14.0 * before.insertion_depth, abs=2e-3)
    for _ in range(60):  # and on points laid since
        last = sim.step(DOWN, DT)
    assert last.friction_force == pytest.approx(7.0 * last.insertion_depth, abs=1e-3)


def test_changed_cutting_acts_on_the_next_tick(coarse_scene):
    sim = Simulator(coarse_scene({"needle.tip.deviation_angle": 0.0}))
    step(sim, *[DOWN] * 200)
    sim.change_interaction({"cutting.force": 0.2})
    assert sim.step(DOWN, DT).tip_force == pytest.approx(0.2, rel=1e-12)


def test_a_refused_change_changes_nothing(coarse_scene):
    sim, twin = (Simulator(coarse_scene()) for _ in range(2))
    step(sim, *[DOWN] * 150)
    step(twin, *[DOWN] * 150)
    scene, snapshot = sim.scene, sim.snapshot()
    for bad in (
        {"friction.kinetic": -1.0},
        {"friction.kinetic": 20.0},  # above the static one
        {"cutting.force": float("nan")},
        {"friction.kinetic": 7.0, "nonsense": 1.0},
        {"puncture.force": 0.1},  # below the cutting force
    ):
        with pytest.raises(SceneError):
            sim.change_interaction(bad)
        assert sim.scene is scene and sim.snapshot() is snapshot
    assert step(sim, *[DOWN] * 20) == step(twin, *[DOWN] * 20)


def test_snapshots_bring_back_the_laws(coarse_scene):
    """A change of friction after the snapshot is undone with it: going on is as before."""
    sim = Simulator(coarse_scene())
    step(sim, *[DOWN] * 150)
    kept = sim.snapshot()
    seen = step(sim, *[DOWN] * 20)
    sim.restore(kept)
    sim.change_interaction({"friction": {"static": 5.0, "kinetic": 4.0}, "cutting.force": 0.1})
    assert step(sim, *[DOWN] * 20) != seen
    sim.restore(kept)
    assert step(sim, *[DOWN] * 20) == seen
    assert sim.scene.interaction.friction.kinetic == 14.0


def test_reset_keeps_changed_laws(coarse_scene):
    """They are parameters: what starts anew is the insertion."""
    sim = Simulator(coarse_scene())
    sim.change_interaction({"cutting.force": 0.1})
    sim.reset()
    step(sim, *[DOWN] * 150)
    assert sim.scene.interaction.cutting.force == 0.1
    assert sim.observe().tip_force == pytest.approx(0.1, rel=1e-9)


def test_statistics_count(simulator, coarse_scene):
    sim = Simulator(coarse_scene())
    step(sim, *[DOWN] * 120)
    statistics = sim.statistics
    assert statistics.ticks == 120 == len(statistics.tick_times)
    assert statistics.iterations > 0 and (statistics.tick_times > 0).all()
    assert statistics.worst_residual < 1e-8


def test_observing_twice_is_the_same_object(simulator):
    sim = simulator()
    o = sim.step(DOWN, DT)
    assert sim.observe() is o
    assert sim.observe().process is Process.FREE
