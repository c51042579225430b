# SPDX-License-Identifier: Apache-2.0
"""Make the recorded sessions of this folder: ``python bags/make_bags.py steering|experiment``.

With ``OPENBLAS_NUM_THREADS=1`` set, as the package's commands do: only then do they replay to the
bit. `steering` is simulated as it stands. `experiment` is what a foreign system might have
recorded, made of a simulation: a finer mesh than the scenes', other parameters, sensor noise
and bias, dropped messages, other frames, topics and clocks. It was never measured.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2._dynamic import serialize_dynamic

from needle_sim_ros import Scene, Simulator
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.session.bag import Bag, Topic
from needle_sim_ros.session.frames import Transform
from needle_sim_ros.session.measured import inverse
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.run import run
from needle_sim_ros.session.schema import message_schema
from needle_sim_ros.session.writer import SessionWriter

HERE = Path(__file__).resolve().parent

# 80 mm into gelatin, the bevel turned by half a turn at 40 mm: an S.
# Coarse, so that it is quick to prepare and to replay.
STEERING = {
    "tissue.mesh.spacing_across": 3e-3,
    "tissue.mesh.spacing_along": 8e-3,
    "tissue.mesh.growth": 3.0,
    "solver.track_spacing": 8e-3,
    "solver.time_step": 0.05,
    "solver.factorization": "superlu",  # the one that is always there: it replays to the bit
    "protocol": [
        {"duration": 8.4, "velocity": [0, 0, -5e-3]},
        {"duration": 2.0, "angular_velocity": [0, 0, np.pi / 2]},
        {"duration": 8.0, "velocity": [0, 0, -5e-3]},
        {"duration": 1.0},
    ],
}

# The "phantom": gao2016 with half the spacing of its mesh and other tissue.
TRUTH = {
    "tissue.youngs_modulus": 18.0e3,
    "interaction.friction.static": 19.5,
    "interaction.friction.kinetic": 17.0,
    "interaction.cutting.force": 0.38,
    "interaction.cutting.relaxation_time": 2.0,
    "interaction.puncture.force": 0.60,
}
FINER = {
    "tissue.mesh.spacing_across": 0.5e-3,
    "tissue.mesh.spacing_along": 1.0e-3,
    "solver.dynamics": "quasi_static",
    "solver.modes": 0,
    "solver.time_step": 0.01,
    "protocol": [
        {"duration": 1.0},
        {"duration": 12.0, "velocity": [0, 0, -5e-3]},
        {"duration": 5.0},
        {"duration": 12.0, "velocity": [0, 0, 5e-3]},
        {"duration": 0.5},
    ],
}
FORCE_NOISE, TORQUE_NOISE, MARKER_NOISE = 0.02, 2e-4, 1e-4
BIAS = np.array([0.05, -0.08, 0.21, 1e-3, -2e-3, 5e-4])
SIGN = -1  # the sensor shows what the needle does to the tissue
CLOCK = 1_700_000_000_123_456_789  # ns
DROPPED, GAP = 0.03, (9.0, 9.25)
# Sensor to needle base; robot world to tissue; tracker to tissue.
SENSOR = Transform((0.0, 0.0, -0.03), (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
ROBOT = Transform((0.42, -0.1, -0.35), (0.0, 0.0, 1.0, 0.0))
TRACKER = Transform((-0.2, 0.3, 0.5), (1.0, 0.0, 0.0, 0.0))


def steering(folder: Path) -> None:
    """Record a steered insertion in 3D."""
    scene = Scene.load("bevel_gelatin_22g", STEERING)
    step = scene.solver.time_step
    writer = SessionWriter(folder, scene, step)
    commands = protocol_commands(scene.protocol, step)
    run(
        Simulator(scene),
        commands,
        step,
        watchers=[lambda command, seen: writer.observe(seen, Motion.of(command))],
    )
    writer.close(30.0)


def experiment(folder: Path, changes: dict[str, Any] | None = None, seed: int = 5) -> None:
    """Record the synthetic experiment.

    Parameters
    ----------
    folder : Path
        Must not exist.
    changes : dict, optional
        To the scene, e.g. a coarser mesh.
    seed : int
        Of noise and losses.
    """
    scene = Scene.load("gao2016", {**TRUTH, **FINER, **(changes or {})})
    step = scene.solver.time_step
    done = run(Simulator(scene), protocol_commands(scene.protocol, step), step)
    series, random = done.series, np.random.default_rng(seed)
    messages: list[tuple[str, int, dict[str, Any]]] = []

    def kept(every: int) -> list[int]:
        rows = np.arange(0, len(series), every)
        time = series.time[rows]
        lost = (random.random(len(rows)) < DROPPED) | ((time > GAP[0]) & (time < GAP[1]))
        lost[0] = False
        return rows[~lost].tolist()

    def stamp(row: int) -> tuple[int, dict[str, Any]]:
        late = int(random.uniform(0, 3e5))  # messages are logged after they are stamped
        at = CLOCK + round(series.time[row] * 1e9)
        sec, nanosec = divmod(at, 1_000_000_000)
        return at + late, {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": ""}

    assert series.base_position is not None and series.base_orientation is not None
    bases = inverse(ROBOT).poses(np.hstack([series.base_position, series.base_orientation]))
    for row in kept(2):
        log, header = stamp(row)
        pose = {"position": _xyz(bases[row, :3]), "orientation": _xyzw(bases[row, 3:])}
        messages.append(("/robot/ee_pose", log, {"header": header, "pose": pose}))
    noise = np.repeat([FORCE_NOISE, TORQUE_NOISE], 3)
    wrenches = inverse(SENSOR).wrenches(np.hstack([series.base_force, series.base_torque]))
    shown = SIGN * wrenches + BIAS + noise * random.standard_normal(wrenches.shape)
    for row in kept(1):
        log, header = stamp(row)
        wrench = {"force": _xyz(shown[row, :3]), "torque": _xyz(shown[row, 3:])}
        messages.append(("/ati/data", log, {"header": header, "wrench": wrench}))
    beads = inverse(TRACKER).points(series.marker_positions)
    beads = beads + MARKER_NOISE * random.standard_normal(beads.shape)
    for row in kept(10):
        log, header = stamp(row)
        poses = [
            {"position": _xyz(place), "orientation": _xyzw((0.0, 0.0, 0.0, 1.0))}
            for place in beads[row]
        ]
        messages.append(("/tracker/beads", log, {"header": header, "poses": poses}))
        if row % 200 == 0:
            messages.append(("/camera/status", log, {"data": "recording"}))
    _write(folder, messages)


def _write(folder: Path, messages: list[tuple[str, int, dict[str, Any]]]) -> None:
    kinds = {
        "/robot/ee_pose": "geometry_msgs/msg/PoseStamped",
        "/ati/data": "geometry_msgs/msg/WrenchStamped",
        "/tracker/beads": "geometry_msgs/msg/PoseArray",
        "/camera/status": "std_msgs/msg/String",
    }
    bag = Bag(folder)
    ids = {name: bag.add_topic(Topic(name, kind)) for name, kind in kinds.items()}
    encoders = {
        name: serialize_dynamic(kind, message_schema(kind).text)[kind]
        for name, kind in kinds.items()
    }
    messages.sort(key=lambda entry: entry[1])
    for start in range(0, len(messages), 2000):
        part = messages[start : start + 2000]
        bag.write([(ids[n], k, time, encoders[n](m)) for k, (n, time, m) in enumerate(part)])
    bag.close()


def _xyz(vector: Any) -> dict[str, float]:
    return dict(zip("xyz", map(float, vector), strict=True))


def _xyzw(quaternion: Any) -> dict[str, float]:
    return dict(zip("xyzw", map(float, quaternion), strict=True))


if __name__ == "__main__":
    makers = {"steering": steering, "experiment": experiment}
    for name in sys.argv[1:] or makers:
        makers[name](HERE / {"experiment": "phantom_synthetic"}.get(name, name))
