# SPDX-License-Identifier: Apache-2.0
"""The protocol as commands per tick."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_sim_ros.errors import SceneError
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene, Segment


def _protocol(segments: list[tuple[float, float]]) -> list[Segment]:
    return [Segment(duration=d, velocity=(0.0, 0.0, v)) for d, v in segments]


def _path(commands: list, dt: float) -> np.ndarray:
    return np.cumsum([c.velocity[2] * dt for c in commands])


def test_whole_ticks_are_the_segments_own_commands() -> None:
    commands = protocol_commands(_protocol([(0.03, -1e-3), (0.02, 0.0)]), 0.01)
    assert [c.velocity[2] for c in commands] == [-1e-3] * 3 + [0.0] * 2
    assert commands[0] is commands[2]


def test_a_tick_across_two_segments_takes_their_mean() -> None:
    commands = protocol_commands(_protocol([(0.025, -1e-3), (0.025, 2e-3)]), 0.01)
    assert [c.velocity[2] for c in commands] == pytest.approx([-1e-3, -1e-3, 0.5e-3, 2e-3, 2e-3])


def test_segments_shorter_than_a_tick_are_not_lost() -> None:
    commands = protocol_commands(_protocol([(0.004, -1e-3), (0.002, 5e-3), (0.002, 0.0)]), 0.01)
    assert len(commands) == 1
    assert commands[0].velocity[2] == pytest.approx((-4e-6 + 10e-6) / 0.01)


def test_paper_protocol_reaches_sixty_millimetres_and_returns() -> None:
    scene = Scene.load("gao2016")
    commands = protocol_commands(scene.protocol, scene.solver.time_step)
    path = _path(commands, scene.solver.time_step)
    assert path.min() == pytest.approx(-0.070, abs=1e-12)
    assert path[-1] == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(st.floats(1e-4, 0.2), st.floats(-4e-3, 4e-3)),
        min_size=1,
        max_size=6,
    ),
    st.floats(1e-3, 0.05),
)
def test_the_stage_ends_where_the_protocol_says(segments: list, step: float) -> None:
    commands = protocol_commands(_protocol(segments), step)
    wanted = sum(d * v for d, v in segments)
    assert _path(commands, step)[-1] == pytest.approx(wanted, abs=1e-9)
    total = sum(d for d, _ in segments)
    assert len(commands) * step >= total * (1 - 1e-6)
    assert (len(commands) - 1) * step < total


def test_no_protocol_is_refused() -> None:
    with pytest.raises(SceneError, match="protocol"):
        protocol_commands(_protocol([]), 0.01)


def test_endless_protocol_is_refused_before_it_fills_the_memory() -> None:
    with pytest.raises(SceneError, match="ticks"):
        protocol_commands(_protocol([(9e4, 0.0), (9e4, 0.0), (9e4, 0.0)]), 0.01)
