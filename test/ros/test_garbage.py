# SPDX-License-Identifier: Apache-2.0
"""Garbage is collected in pieces, when there is room for them."""

import gc
import weakref

import pytest

from needle_sim_ros.ros import garbage
from needle_sim_ros.ros.garbage import Garbage


class Circle:
    """Refers to itself, so that only a collection ends it."""

    def __init__(self):
        self.itself = self


@pytest.fixture
def switched_off():
    """Python's own collections do not come in between."""
    was = gc.isenabled()
    gc.collect()
    gc.disable()
    yield
    if was:
        gc.enable()


@pytest.mark.usefixtures("switched_off")
def test_what_dies_young_is_collected_once_there_is_room():
    alive = []
    gone = weakref.ref(Circle())
    Garbage(lambda room: alive.append((room > 0, gone() is not None))).collect()
    assert alive == [(True, True)]
    assert gone() is None


@pytest.mark.usefixtures("switched_off")
def test_what_dies_old_is_collected_too(monkeypatch):
    monkeypatch.setattr(garbage, "_MIDDLE", 10 * garbage.PERIOD)
    monkeypatch.setattr(garbage, "_ALL", 50 * garbage.PERIOD)
    collector = Garbage(lambda room: None)
    old = Circle()
    for _ in range(12):
        collector.collect()
    gone = weakref.ref(old)
    del old
    for _ in range(12, 49):
        collector.collect()
    collector.collect()
    assert gone() is None


def test_generations_take_turns(monkeypatch):
    asked = []
    monkeypatch.setattr(gc, "isenabled", lambda: False)
    monkeypatch.setattr(gc, "collect", asked.append)
    collector = Garbage(lambda room: None)
    for _ in range(round(600.0 / garbage.PERIOD)):
        collector.collect()
    assert asked[-1] == 2
    assert [asked.count(generation) for generation in (1, 2)] == [59, 1]


def test_pythons_own_collections_are_left_alone(monkeypatch):
    monkeypatch.setattr(gc, "isenabled", lambda: True)
    monkeypatch.setattr(gc, "collect", lambda *_: pytest.fail("collected"))
    Garbage(lambda room: pytest.fail("waited")).collect()
