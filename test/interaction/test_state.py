# SPDX-License-Identifier: Apache-2.0
"""The state of the contact takes over a solution field by field, in order."""

from needle_sim_ros.interaction.solution import BalanceSolution
from needle_sim_ros.interaction.state import ContactState


def test_a_solution_is_the_end_of_a_state():
    """What a solution has beyond the state's fields comes last."""
    names = BalanceSolution._fields[:-2]
    assert ContactState._fields[-len(names) :] == names
    assert BalanceSolution._fields[-2:] == ("overlap", "lack")
    assert ContactState._fields[: -len(names)] == (
        "track",
        "touching",
        "inserted",
        "depth",
        "front",
        "rate",
        "heading",
        "bearing",
    )
