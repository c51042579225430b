# SPDX-License-Identifier: Apache-2.0
"""How the node did while the host withheld nothing."""

import os

import pytest

from needle_sim_ros.ros.soak.host import Reading, stolen_time, undisturbed

CORES = os.cpu_count()


def test_only_stretches_without_stolen_time_count():
    found = undisturbed(
        [
            Reading(0.0, 0, 0, 1.0),
            Reading(1.0, 990, 10, 1.0),
            Reading(2.0, 1490, 510, 1.4),
            Reading(4.0, 3480, 520, 1.4),
        ]
    )
    assert found.seconds == 3.0
    assert found.overruns == pytest.approx(20 / 3000)
    assert found.stolen == pytest.approx(0.4 / (4.0 * CORES))


def test_where_the_host_is_never_quiet_there_is_no_figure():
    found = undisturbed([Reading(0.0, 0, 0, 0.0), Reading(1.0, 900, 100, 0.2)])
    assert found.overruns is None
    assert found.seconds == 0.0


@pytest.mark.parametrize("readings", [[], [Reading(3.0, 1, 0, 0.5)]])
def test_nothing_is_read_off_less_than_two_readings(readings):
    assert undisturbed(readings).stolen == 0.0


def test_stolen_time_is_that_of_all_processors():
    first = stolen_time()
    assert 0.0 <= first <= stolen_time()
