# SPDX-License-Identifier: Apache-2.0
"""``benchmark identify`` in a tiny form: the truth is found, and the figures are the table's."""

import numpy as np
import pytest

from needle_sim_ros.benchmark import identify as module

SHORT = [
    {"duration": 4.0, "velocity": [0, 0, -1e-2]},
    {"duration": 2.0, "velocity": [0, 0, 1e-3]},
    {"duration": 2.0, "velocity": [0, 0, -1e-3]},
    {"duration": 1.0},
    {"duration": 2.0, "velocity": [0, 0, 5e-3]},
]
DRAWS = 4


@pytest.fixture(scope="module")
def result(coarse_scene):
    scene = coarse_scene({"markers": [[-0.003, 0.0, -0.01], [-0.01, 0.0, -0.02]]})
    steps = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_TICK", 0.2)
        patch.setattr(module, "DEFAULT", ("youngs_modulus", "friction.kinetic", "cutting.force"))
        patch.setattr(module, "_SESSION", SHORT)
        patch.setattr(module, "_HELD_OUT", SHORT[:1])
        patch.setattr(module, "_QUICK_DRAWS", DRAWS)
        found = module.identify(
            scene, quick=True, progress=lambda *step: steps.append(step), workers=1
        )
    assert steps[-1][0] == steps[-1][1]
    return found


def test_the_truth_is_found_from_a_start_beside_it(result):
    errors = {row["parameter"]: row["fitted"] / row["truth"] - 1 for row in result.table}
    starts = {row["parameter"]: row["start"] / row["truth"] - 1 for row in result.table}
    assert all(abs(start) > 0.2 for start in starts.values())
    assert abs(errors["youngs_modulus"]) < 0.05
    assert abs(errors["friction.kinetic"]) < 0.02
    assert abs(errors["cutting.force"]) < 0.05
    assert 0.8 < result.figures["reduced_chi_square"] < 1.2
    assert result.figures["held_out_force_rms_n"] < 0.03


def test_errors_are_those_of_the_draws(result):
    """What the fits of the draws spread by is what each says of itself."""
    for row in result.table:
        assert row["draws"] == DRAWS
        assert 0.1 < row["spread of draws"] / row["standard error"] < 3
        short = row["parameter"].replace(".", "_")
        assert result.figures[f"{short}_inside_95"] == row["inside"] / DRAWS
        relative = abs(row["fitted"] / row["truth"] - 1)
        assert result.figures[f"{short}_error"] == pytest.approx(relative)
        assert result.figures[f"{short}_worst_error"] >= relative * (1 - 1e-9)
    inside = [row["inside"] / DRAWS for row in result.table]
    assert result.figures["least_inside_95"] == np.min(inside) >= 0.5
