# SPDX-License-Identifier: Apache-2.0
"""The messages of a tick made all at once by compiled code are those made one by one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_sim_ros import BaseCommand, Scene, Simulator
from needle_sim_ros.session import cdr, channels, encoding

pytestmark = pytest.mark.skipif(encoding._messages is None, reason="built without a C compiler")

TISSUE, BASE = "tissue_\u00e4", "needle_base"
MARKERS = [[0.004, 0.0, -0.02], [-0.01, 0.0, -0.03]]
BLOCK = {
    "tissue.mesh.spacing_across": 10e-3,
    "tissue.mesh.largest": 20e-3,
    "solver.track_spacing": 4e-3,
    "solver.dynamics": "quasi_static",
    "solver.modes": 0,
    "markers": [[0.004, 0.002, -0.02], [-0.01, 0.012, -0.03]],
}
NUMBER = st.floats()
SMALL = st.floats(-10, 10)


def numbers(kind, count):
    return st.tuples(*[kind] * count)


@pytest.mark.parametrize("kind", ["2D", "2D without markers", "3D"])
def test_of_what_a_needle_does_they_are_the_same_bytes(kind, coarse_scene):
    scene = coarse_scene({"markers": MARKERS if kind == "2D" else []})
    scene = Scene.load("bevel_gelatin_22g", BLOCK) if kind == "3D" else scene
    simulator, encoders = Simulator(scene), encoding.output_encoders(TISSUE, BASE)
    turning, processes = [0.0, 0.05, 0.02 if kind == "3D" else 0.0], set()
    for k in range(70):
        down = BaseCommand(velocity=[0.0, 0.0, -1e-2])
        aside = BaseCommand(velocity=[1e-3, 0.0, 0.0], angular_velocity=turning)
        observation = simulator.step(down if k < 60 else aside, 0.05)
        processes.add(observation.process.value)
        stamp = 61_500_000_000 + k
        made = encoders.together(stamp, observation)
        assert isinstance(made, tuple)
        assert list(made) == [encode(stamp, observation) for _, encode in encoders.each]
    assert "insertion" in processes
    assert observation.readings.tip_slope[0] != 0


def outputs(
    stamp=0, deflection=(0,) * 3, slope=(0,) * 2, place=(0,) * 3, wrench=(0,) * 6, pose=(0,) * 7,
    scalars=(0,) * 3, cloud=None, markers=(), shifts=(),
):  # fmt: skip
    made = encoding._messages.outputs(
        stamp,
        cdr.ENCAPSULATION,
        cdr.header(TISSUE),
        cdr.header(BASE),
        (deflection, slope, place, wrench[:3], wrench[3:], scalars[0]),
        math.hypot(*slope),
        np.array(pose[:3], dtype=float),
        np.array(pose[3:], dtype=float),
        scalars[1],
        scalars[2],
        cdr.text("hold"),
        cdr.blank_cloud(TISSUE, len(markers)) if cloud is None else cloud,
        np.array(markers, dtype=float, order="C").reshape(-1, 3),
        np.array(shifts, dtype=float, order="C"),
    )
    return dict(zip(channels.OUTPUTS, made, strict=True))


@given(
    st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1),
    numbers(NUMBER, 3),
    numbers(NUMBER, 3),
    numbers(NUMBER, 6),
    numbers(NUMBER, 7),
    numbers(NUMBER, 3),
)
def test_so_they_are_whatever_the_numbers(stamp, deflection, place, wrench, pose, scalars):
    made = outputs(stamp, deflection, (0.0, 0.0), place, wrench, pose, scalars)
    stamped = {
        channels.TIP_DEFLECTION: cdr.stamped_doubles(BASE, 3)(stamp, deflection),
        channels.TIP_POSE: cdr.stamped_doubles(TISSUE, 7)(stamp, place + pose[3:]),
        channels.BASE_WRENCH: cdr.stamped_doubles(BASE, 6)(stamp, wrench),
        channels.STAGE_POSE: cdr.stamped_doubles(TISSUE, 7)(stamp, pose),
    }
    plain = {
        channels.FRICTION_FORCE: cdr.float64(scalars[0]),
        channels.INSERTION_DEPTH: cdr.float64(scalars[1]),
        channels.TIP_FORCE: cdr.float64(scalars[2]),
        channels.PROCESS: cdr.text("hold"),
    }
    assert {channel: made[channel] for channel in {**stamped, **plain}} == {**stamped, **plain}


@given(st.lists(numbers(SMALL, 6), max_size=5))
def test_so_are_clouds_of_any_size(rows):
    rows = np.array(rows).reshape(-1, 6)
    cloud = cdr.marker_cloud(TISSUE)
    for plane in (False, True):
        markers, moved = rows[:, :3], rows[:, 3:].copy()
        if plane:
            moved[:, 1] = 0.0
        shifts = moved[:, [0, 2]] if plane else moved
        made = outputs(7, markers=markers, shifts=shifts)[channels.TISSUE_MARKERS]
        assert made == cloud(7, markers + moved, moved)


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"stamp": 2**31 * 10**9}, OverflowError),
        ({"stamp": 1.5}, TypeError),
        ({"deflection": (0.0, 0.0)}, TypeError),
        ({"wrench": ("x",) * 6}, TypeError),
        ({"pose": (0.0,) * 6}, ValueError),
        ({"markers": np.zeros((2, 3)), "shifts": np.zeros((1, 3))}, ValueError),
        (
            {"markers": np.zeros((2, 3)), "shifts": np.zeros((2, 3)), "cloud": b"\0" * 40},
            ValueError,
        ),
        ({"cloud": "text"}, TypeError),
    ],
)
def test_what_does_not_fit_is_refused(given, error):
    with pytest.raises(error):
        outputs(**given)
