# SPDX-License-Identifier: Apache-2.0
"""Shipped files are found in a checkout, under a prefix, and from colcon's share."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from needle_sim_ros import resources
from needle_sim_ros.errors import SceneError, SessionError

ROOT = Path(__file__).resolve().parents[1]
SCENE = "name: only_here\n"


def lay_out(folder: Path) -> None:
    (folder / "config" / "scenes").mkdir(parents=True)
    (folder / "config" / "scenes" / "only_here.yaml").write_text(SCENE)
    (folder / "bags").mkdir()
    shutil.copy(ROOT / "package.xml", folder)


@pytest.mark.parametrize(
    ("package", "share"),
    [
        ("checkout/needle_sim_ros", "checkout"),
        ("venv/lib/python3.11/site-packages/needle_sim_ros", "venv/share/needle_sim_ros"),
        ("local/lib/python3.12/dist-packages/needle_sim_ros", "local/share/needle_sim_ros"),
        ("target/needle_sim_ros", "target/share/needle_sim_ros"),
    ],
)
def test_found_from_where_the_package_is(tmp_path, package, share):
    lay_out(tmp_path / share)
    where = tmp_path / package
    where.mkdir(parents=True, exist_ok=True)
    for name in ("__init__.py", "errors.py", "resources.py"):
        shutil.copy(ROOT / "needle_sim_ros" / name, where)
    script = (
        "from needle_sim_ros import resources\n"
        "print(resources.find_scene('only_here'))\n"
        "print(resources.bags_directory())\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", script],
        cwd=where.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    scene, bags = found.stdout.splitlines()
    assert Path(scene).read_text() == SCENE
    assert Path(bags) == tmp_path / share / "bags"


def test_unknown_scene_names_those_there_are():
    with pytest.raises(SceneError, match=r"gao2016.*did you mean 'gao2016'"):
        resources.find_scene("gao2061")


def test_this_checkout_comes_first():
    assert next(resources.roots()) == ROOT


def test_a_session_of_the_package_is_found_by_its_name(tmp_path, monkeypatch):
    from needle_sim_ros.session.reader import mcap_files

    monkeypatch.chdir(tmp_path)
    assert [file.name for file in mcap_files("gao2016")] == ["gao2016_0.mcap"]
    (tmp_path / "gao2016").mkdir()  # what is here comes first
    with pytest.raises(SessionError, match="no MCAP file"):
        mcap_files("gao2016")
