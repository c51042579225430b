# SPDX-License-Identifier: Apache-2.0
"""The label of a tick."""

import pytest

from needle_sim_ros.interaction.process import Process, classify


@pytest.mark.parametrize(
    ("touching", "inserted", "advance", "process"),
    [
        (False, False, 1e-3, Process.FREE),
        (True, False, 1e-3, Process.CONTACT),
        (True, False, -1e-3, Process.CONTACT),
        (True, False, 0.0, Process.CONTACT),
        (False, True, 1e-6, Process.INSERTION),
        (False, True, 0.0, Process.HOLD),
        (False, True, 1e-13, Process.HOLD),
        (False, True, -1e-6, Process.RETRACTION),
    ],
)
def test_classify(touching, inserted, advance, process):
    assert classify(touching, inserted, advance) is process


def test_names_are_what_the_topic_carries():
    assert [p.value for p in Process] == ["free", "contact", "insertion", "hold", "retraction"]
