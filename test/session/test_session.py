# SPDX-License-Identifier: Apache-2.0
"""A session written without ROS is read back, replays to the bit, and survives damage."""

import random
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from mcap.reader import make_reader

from needle_sim_ros.errors import SessionError
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.history import History, motions_from_json
from needle_sim_ros.session.motion import STILL, Motion
from needle_sim_ros.session.reader import read_session
from needle_sim_ros.session.series import Series
from needle_sim_ros.session.writer import SessionWriter
from needle_sim_ros.simulator import Simulator

DT = 0.01
COARSE = {
    "solver.dynamics": "quasi_static",
    "solver.track_spacing": 4.0e-3,
    "tissue.mesh.element": "quad1",
    "tissue.mesh.spacing_across": 2.0e-3,
    "tissue.mesh.spacing_along": 4.0e-3,
    "markers": [[0.0, 0.0, -0.01], [0.005, 0.0, -0.02]],
    "base.position": [0.0, 0.0, 0.1302],
}
DOWN = Motion("velocity", (0.0, 0.0, -0.05), (0.0, 0.0, 0.0))
# A quaternion that normalising twice changes, and one that leaves something out.
TURNED = Motion("pose", (1e-4, 0.0, 0.1232), (0.9999999, 0.0, 1.1e-3, 0.0))
HIGHER = Motion("pose", (1e-4, 0.0, 0.1242), None)
MOTIONS = [DOWN] * 14 + [TURNED] * 2 + [STILL] * 3 + [HIGHER] * 3


def simulate(scene, motions):
    simulator = Simulator(scene)
    return [simulator.step(motion.command(), DT) for motion in motions]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return scene, observations, and the folder of their session."""
    scene = Scene.load("gao2016", COARSE)
    observations = simulate(scene, MOTIONS)
    folder = tmp_path_factory.mktemp("sessions") / "one"
    writer = SessionWriter(folder, scene, DT)
    for observation, motion in zip(observations, MOTIONS, strict=True):
        writer.observe(observation, motion)
    writer.event(10**9, "remark", text="done")
    status = writer.close()
    assert (status.lost, status.error) == (0, "")
    return scene, observations, folder


def test_what_is_read_is_what_was_observed(recorded):
    scene, observations, folder = recorded
    session = read_session(folder)
    expected = Series.from_observations(observations, scene)
    for name in ("base_force", "base_torque", "tip_position", "tip_deflection", "tip_force"):
        np.testing.assert_array_equal(getattr(session.series, name), getattr(expected, name), name)
    for name in ("insertion_depth", "friction_force", "base_position", "base_orientation"):
        np.testing.assert_array_equal(getattr(session.series, name), getattr(expected, name), name)
    np.testing.assert_allclose(session.series.time, expected.time, atol=1e-9)
    assert session.series.process == expected.process
    assert {"contact", "insertion", "hold", "retraction"} <= set(expected.process)
    np.testing.assert_allclose(session.series.marker_reference, COARSE["markers"], atol=1e-8)
    moved = session.series.marker_displacements
    np.testing.assert_allclose(moved, expected.marker_displacements, rtol=1e-6, atol=1e-9)
    assert np.abs(moved).max() > 1e-5
    assert Scene.from_yaml(session.scene_text) == scene
    assert session.series.scene_text == session.scene_text
    assert session.metadata["scene"] == "gao2016"
    assert float(session.metadata["tick_period"]) == DT
    assert session.events == [(10**9, {"event": "remark", "text": "done"})]
    assert session.complete and session.before == [] and session.inputs == []


def test_the_motions_replay_to_the_bit(recorded):
    _, observations, folder = recorded
    session = read_session(folder / "one_0.mcap")
    motions = [motion for _, motion in session.motions]
    assert motions == MOTIONS
    again = simulate(Scene.from_yaml(session.scene_text), motions)
    for a, b in zip(observations, again, strict=True):
        assert a.base_orientation.tobytes() == b.base_orientation.tobytes()
        assert a.base_force.tobytes() == b.base_force.tobytes()
        assert a.tip_position.tobytes() == b.tip_position.tobytes()


def test_equal_runs_give_equal_messages(recorded, tmp_path):
    scene, observations, folder = recorded
    writer = SessionWriter(tmp_path / "one", scene, DT)
    for observation, motion in zip(observations, MOTIONS, strict=True):
        writer.observe(observation, motion)
    writer.close()

    def messages(path):
        with (path / "one_0.mcap").open("rb") as stream:
            return [
                (c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()
            ]

    first = [m for m in messages(folder) if m[0] != "/needle_sim/events"]
    assert messages(tmp_path / "one") == first


def test_a_file_cut_anywhere_gives_what_came_before_the_cut(recorded, tmp_path):
    _, observations, folder = recorded
    data = (folder / "one_0.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    lengths = []
    for end in sorted({*range(0, len(data), 997), len(data) - 1}):
        cut.write_bytes(data[:end])
        try:
            session = read_session(cut)
        except SessionError as error:
            assert "holds no scene" in str(error)
            continue
        assert not session.complete
        lengths.append(len(session.series))
        assert len(session.motions) == lengths[-1]
    assert lengths == sorted(lengths)
    assert lengths[-1] == len(observations)


def test_a_damaged_file_is_read_up_to_the_damage_or_refused(recorded, tmp_path):
    _, observations, folder = recorded
    data = bytearray((folder / "one_0.mcap").read_bytes())
    path = tmp_path / "flipped.mcap"
    generator = random.Random(1)
    for _ in range(60):
        place, bit = generator.randrange(len(data)), 1 << generator.randrange(8)
        data[place] ^= bit
        path.write_bytes(data)
        data[place] ^= bit
        try:
            session = read_session(path)
        except SessionError:
            continue
        whole = [observation.time for observation in observations]
        np.testing.assert_allclose(session.series.time, whole[: len(session.series)], atol=1e-9)


def test_a_scene_that_was_damaged_is_not_replayed(recorded, tmp_path):
    data = (recorded[2] / "one_0.mcap").read_bytes()
    assert data.count(b"youngs_modulus: 15000.0") == 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data.replace(b"youngs_modulus: 15000.0", b"youngs_modulus: 16000.0"))
    with pytest.raises(SessionError, match=r"damaged at byte .*attachment.s checksum"):
        read_session(path)


def test_what_is_no_session_is_refused_with_the_reason(tmp_path):
    with pytest.raises(SessionError, match="no such session"):
        read_session(tmp_path / "nothing")
    with pytest.raises(SessionError, match="no MCAP file in this folder"):
        read_session(tmp_path)
    (tmp_path / "a.mcap").write_bytes(b"not MCAP at all")
    with pytest.raises(SessionError, match="not an MCAP file"):
        read_session(tmp_path)


def test_a_history_keeps_runs_and_every_bit():
    history = History()
    assert motions_from_json(history.to_json()) == []
    odd = Motion("velocity", (0.1 + 0.2, -1 / 3, 5e-324), None)
    for motion in [DOWN] * 3 + [TURNED] + [odd] * 2 + [Motion(*_parts(DOWN))]:
        history.add(motion)
    expected = [(DOWN, 3), (TURNED, 1), (odd, 2), (DOWN, 1)]
    assert motions_from_json(history.to_json()) == expected
    assert history.ticks == 7
    history.clear()
    assert (history.ticks, motions_from_json(history.to_json())) == (0, [])


def _parts(motion):
    return motion.kind, motion.linear, motion.angular


def test_a_history_that_grows_too_long_is_given_up_and_says_so():
    history = History(limit=3)
    for k in range(5):
        history.add(Motion("velocity", (float(k), 0.0, 0.0), None))
    assert not history.complete
    assert motions_from_json(history.to_json()) is None
    assert history.ticks == 5


def test_a_history_that_was_given_up_begins_again():
    history = History(limit=3)
    history.reserve()
    for _ in range(2):
        for k in range(5):
            history.add(Motion("pose", (float(k), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
        history.clear()
        history.reserve()
    history.add(DOWN)
    history.add(TURNED)
    assert history.complete
    assert motions_from_json(history.to_json()) == [(DOWN, 1), (TURNED, 1)]


WITHOUT_ROS = """
    import sys
    for name in ("rclpy", "geometry_msgs", "std_msgs", "sensor_msgs", "rosidl_parser"):
        sys.modules[name] = None
    from pathlib import Path
    from needle_sim_ros.scene import Scene
    from needle_sim_ros.session import reader, recorder, series, writer
    session = writer.SessionWriter(Path(sys.argv[1]), Scene.load("gao2016"), 0.01)
    assert not session.close().error
    assert reader.read_session(sys.argv[1]).complete
"""


def test_sessions_are_written_and_read_without_rclpy(tmp_path):
    command = [sys.executable, "-c", textwrap.dedent(WITHOUT_ROS), str(tmp_path / "one")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
