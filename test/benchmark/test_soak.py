# SPDX-License-Identifier: Apache-2.0
"""The soak's plan, and what it does without a node; its parts are tested in test/ros/soak."""

import os

import pytest

from needle_sim_ros.benchmark.soak import plan, soak
from needle_sim_ros.cli import main
from needle_sim_ros.errors import NeedleSimError


def test_the_full_soak_is_what_is_promised():
    full = plan(None, quick=False)
    assert (full.steady, full.rate) == (600.0, 1000.0)
    assert (full.hostile, full.endings, full.cycles) == (100_000, 50, 100)


def test_minutes_change_the_load_only():
    assert plan(2.0, quick=False).steady == 120.0
    assert plan(2.0, quick=False).endings == 50
    assert plan(2.0, quick=True).steady == 120.0
    assert plan(None, quick=True).seconds < 90


def test_without_ros_it_says_what_it_needs(coarse_scene):
    with pytest.raises(NeedleSimError, match="needs ROS 2"):
        soak(coarse_scene(), quick=True)


@pytest.mark.parametrize("minutes", ["0", "-1", "nan", "x"])
def test_minutes_that_are_none_are_refused(minutes, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["benchmark", "soak", "--minutes", minutes])
    assert ended.value.code == 2
    assert "--minutes" in capsys.readouterr().err


def test_only_the_soak_has_minutes(capsys):
    assert main(["benchmark", "speed", "--minutes", "1"]) == 2
    assert "only benchmark soak" in capsys.readouterr().err


@pytest.mark.parametrize("option", [["--dedicated-core", "1"], ["--keep-awake"]])
def test_only_the_soak_has_a_word_on_processors(option, capsys):
    assert main(["benchmark", "speed", *option]) == 2
    assert f"{option[0]}: only benchmark soak" in capsys.readouterr().err


def test_a_core_of_its_own_is_for_the_load():
    assert plan(None, quick=False).dedicated_core == -1
    assert plan(None, quick=False, dedicated_core=1).dedicated_core == 1
    assert plan(None, quick=True, dedicated_core=1).dedicated_core == 1


def test_so_are_processors_kept_awake():
    assert plan(None, quick=False).keep_awake is False
    assert plan(None, quick=True, keep_awake=True).keep_awake is True


def test_what_contradicts_itself_is_refused_by_the_node(capsys):
    pytest.importorskip("rclpy")
    options = ["--quick", "--keep-awake", "--dedicated-core", str(max(os.sched_getaffinity(0)))]
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("one processor")
    assert main(["benchmark", "soak", *options]) == 2
    assert "keep_awake = True: the loop waits awake" in capsys.readouterr().err


@pytest.mark.parametrize("core", ["4095", "-2"])
def test_a_core_that_is_none_is_refused(core, capsys):
    pytest.importorskip("rclpy")
    assert main(["benchmark", "soak", "--quick", "--dedicated-core", core]) == 2
    assert f"dedicated_core = {core}: must be one of" in capsys.readouterr().err
