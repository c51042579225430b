# SPDX-License-Identifier: Apache-2.0
"""Every command in the documentation is run, or, where it is long, read by the parser.

A command stands in a block fenced as ```bash, or in one without a language at the start of
a line. What belongs to other programs (colcon, rosdep, RViz) is known by name below, so that
a new one is noticed; the build as a workspace is run by ``.ci/colcon``.
"""

import itertools
import os
import re
import shlex
from pathlib import Path

import pytest

from needle_sim_ros.commands.parser import build_parser
from needle_sim_ros.commands.scene_keys import markdown
from needle_sim_ros.scene import Scene
from needle_sim_ros.schema import keys

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "doc").glob("*.md"), ROOT / "bags/README.md"])
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
# Programs of others: no part of this package answers for them.
_OTHERS = {"rosdep", "pip", "colcon", "rviz2", "source", "python", "foxglove"}
_OWN = {"needle_sim", "sim_node", "managed_sim_node", "ros2", "make", "python3"}
# Short enough to be run with the sizes that the tests use.
_RUN = {"run", "plot", "report", "replay", "salvage", "scene", "completion"}
_SESSIONS = {"SESSION", "BAG", "session", "bags/gao2016"}


def _lines(page):
    for language, block in _FENCE.findall(page.read_text(encoding="utf-8")):
        if language not in ("", "bash"):
            continue
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if not words:
                continue
            program = words[0].rpartition("/")[2]
            if language == "bash" or program in _OWN:
                yield [program, *words[1:]]


def _commands(program):
    found = itertools.chain.from_iterable(map(_lines, PAGES))
    return sorted({tuple(words[1:]) for words in found if words[0] == program})


NEEDLE_SIM = _commands("needle_sim")


def _short():
    """Return the commands to run: of several with the same options the first."""
    different = {}
    for words in NEEDLE_SIM:
        if words[0] in _RUN:
            options = frozenset(word for word in words[1:] if word.startswith("--"))
            different.setdefault((words[0], options or words), words)
    return list(different.values())


def test_every_program_is_known():
    for page in PAGES:
        for words in _lines(page):
            assert words[0] in _OWN | _OTHERS, f"{page.name}: {' '.join(words)}"


@pytest.mark.parametrize("words", NEEDLE_SIM, ids=" ".join)
def test_the_parser_takes_it(words):
    build_parser().parse_args([str(word) for word in words if not word.startswith("...")])


@pytest.mark.parametrize("words", _short(), ids=" ".join)
def test_it_runs(words, coarse, recorded, tmp_path, monkeypatch, capsys):
    from needle_sim_ros.cli import main

    monkeypatch.chdir(tmp_path)
    for name in ("config", "doc"):
        os.symlink(ROOT / name, tmp_path / name)
    (tmp_path / "my_scene.yaml").write_text(Scene.load("gao2016").to_yaml())
    (tmp_path / "planned.yaml").write_text(Scene.load("gao2016").to_yaml())
    taken = [f"{recorded}/bag" if word in _SESSIONS else word for word in words]
    if words[0] == "run":
        taken[2:2] = coarse  # what the page says comes later, and counts
    if "--frames" in taken:
        taken[taken.index("--frames") + 1] = "4"
    if any(word.startswith("/") and not Path(word).exists() for word in taken[1:2]):
        pytest.skip("needs a recording of the reader's own")
    assert main(taken) == 0, capsys.readouterr().err


@pytest.mark.parametrize("words", _commands("ros2"), ids=" ".join)
def test_ros2_finds_it(words):
    assert words[:2] in {("run", "needle_sim_ros"), ("launch", "needle_sim_ros")} or words[0] in {
        "bag",
        "service",
        "topic",
        "param",
        "lifecycle",
    }
    if words[0] == "run":
        assert f'"{words[2]} = ' in (ROOT / "setup.py").read_text()
        _check_parameters(words[3:])
    elif words[0] == "launch":
        launch = (ROOT / "launch" / words[2]).read_text()
        for argument in words[3:]:
            assert f'"{argument.partition(":=")[0]}": (' in launch


def _check_parameters(words):
    """Every -p NAME:=VALUE is a parameter of the node, or of the example that declares it."""
    known = "".join(p.read_text() for p in (ROOT / "needle_sim_ros/ros").glob("*.py"))
    for name in re.findall(r"-p ([\w.]+):=", " ".join(words)):
        assert name.startswith("interaction.") or f'"{name}"' in known, name


@pytest.mark.parametrize("words", _commands("make"), ids=" ".join)
def test_make_has_the_target(words):
    makefile = (ROOT / "Makefile").read_text()
    for target in (word for word in words if "=" not in word):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


@pytest.mark.parametrize("words", _commands("python3"), ids=" ".join)
def test_an_example_exists_and_has_its_test(words):
    example = ROOT / words[0]
    assert (ROOT / "test" / "examples" / f"test_{example.name}").exists()
    source = example.read_text()
    compile(source, str(example), "exec")
    for name in re.findall(r"-p (\w+):=", " ".join(words)):
        assert f'"{name}"' in source


def test_links_between_pages_lead_somewhere():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#\s]+)\)", text):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_scene_format_is_that_of_the_schema():
    page = (ROOT / "doc" / "scene_format.md").read_text(encoding="utf-8")
    _, marker, listed = page.partition("<!-- from here on: needle_sim scene keys -->\n")
    assert marker and listed == markdown(), "doc/scene_format.md: run needle_sim scene keys"


def test_the_list_has_every_key_of_the_schema():
    listed, section = set(), ""
    for line in markdown().splitlines():
        if line.startswith("## "):
            section = "" if line == "## The scene" else line[3:] + "."
        elif match := re.match(r"\| `(\w+)` \|", line):
            listed.add(section + match[1])
    assert listed == set(keys(Scene))


def test_the_small_scene_of_the_page_is_one():
    page = (ROOT / "doc" / "scene_format.md").read_text(encoding="utf-8")
    (text,) = [block for language, block in _FENCE.findall(page) if language == "yaml"]
    assert Scene.from_yaml(text).name == "mine"
