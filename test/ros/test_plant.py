# SPDX-License-Identifier: Apache-2.0
"""The plant behind the node, without ROS: what may run beside its ticks."""

import threading

import numpy as np
import pytest

from needle_sim_ros.ros import outlet
from needle_sim_ros.ros.commands import StageCommands, StageLimits
from needle_sim_ros.ros.outlet import Naming
from needle_sim_ros.ros.plant import _AWAKE, Plant
from needle_sim_ros.session.history import History, motions_from_json
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.reader import read_session

DT = 0.01
PATIENCE = 20.0  # s; a deadlock would last for ever


@pytest.fixture
def plant(coarse_scene):
    commands = StageCommands("tissue", StageLimits(0.1, 1.0, 0.05, 0.0))
    return Plant(coarse_scene(), DT, commands, Naming("tissue", "needle_base"), {})


def drive(plant, number):
    """Tick, every time by another command."""
    for k in range(number):
        plant.commands.velocity((0, 0, -3e-3 - 1e-9 * k), (0, 0, 0), "tissue", plant.time)
        plant.tick()


def test_ticks_go_on_while_a_recording_is_made_ready(plant, tmp_path, monkeypatch):
    """The file is made by one thread while another ticks; the session begins afterwards."""
    drive(plant, 5)
    made = outlet.SessionWriter

    def slow(*args, **keywords):
        ticking = threading.Thread(target=drive, args=(plant, 3), daemon=True)
        ticking.start()
        ticking.join(PATIENCE)
        assert not ticking.is_alive()
        return made(*args, **keywords)

    monkeypatch.setattr(outlet, "SessionWriter", slow)
    folder = plant.start_recording(tmp_path)
    drive(plant, 4)
    plant.stop_recording()
    session = read_session(folder)
    np.testing.assert_allclose(session.series.time, DT * np.arange(9, 13), rtol=1e-12)
    assert session.before is not None
    assert sum(ticks for _, ticks in session.before) == 8


def test_a_history_that_goes_on_leaves_its_copy_alone():
    """What a session begins with is what was applied until then, however late it is written."""
    history = History()
    for k in range(5):
        history.add(Motion("velocity", (0.0, 0.0, 1e-3 * k), None))
    history.change({"friction.kinetic": 3.0})
    copy, expected = history.copy(), history.to_json()
    history.add(Motion("velocity", (1.0, 0.0, 0.0), None))
    history.change({"friction.kinetic": 4.0})
    assert copy.to_json() == expected
    assert copy.ticks == 5
    assert copy.changes == [(5, {"friction.kinetic": 3.0})]
    assert len(motions_from_json(history.to_json())) == 6


def test_who_works_beside_the_ticks_waits_for_one_under_way_but_not_for_long(plant, monkeypatch):
    """Commands must not pile up behind a tick that takes long."""
    begun, over = threading.Event(), threading.Event()

    def long(seen, motion):
        begun.set()
        over.wait(PATIENCE)

    plant.watch = long
    ticking = threading.Thread(target=plant.tick, daemon=True)
    ticking.start()
    assert begun.wait(PATIENCE)
    plant.give_way()  # gives up waiting
    assert ticking.is_alive()
    monkeypatch.setattr("needle_sim_ros.ros.plant._PATIENCE", PATIENCE)
    waiting = threading.Thread(target=plant.give_way, daemon=True)
    waiting.start()
    assert waiting.is_alive()
    over.set()
    waiting.join(PATIENCE / 2)
    ticking.join(PATIENCE)
    assert not (waiting.is_alive() or ticking.is_alive())
    plant.give_way()


def test_who_needs_more_time_than_is_left_waits_for_the_next_tick(plant, monkeypatch):
    slept = []
    monkeypatch.setattr("needle_sim_ros.ros.plant.time.sleep", slept.append)
    for left, room in ((5e-5, 1e-4), (2e-4, 1e-4), (-1e-3, 1e-4), (5e-5, 0.0)):
        plant.time_left = lambda left=left: left
        plant.give_way(room)
    # until it has begun; but not where it is late already: it is under way, or waited for
    assert slept == [5e-5 + _AWAKE]
