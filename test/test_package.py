# SPDX-License-Identifier: Apache-2.0
"""The package as a whole: its metadata agree, everything imports, imports point one way."""

import ast
import functools
import importlib
import pkgutil
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

import needle_sim_ros

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "needle_sim_ros"

# A part may import what stands in an earlier row, and its neighbours if no circle results.
LAYERS = (
    {"errors"},
    {
        "command",
        "compiled",
        "geometry",
        "lazily",
        "parallel",
        "plain",
        "results_file",
        "resources",
        "schema",
    },
    {"scene", "scene_checks"},
    {"tissue", "needle", "protocol"},
    {"interaction"},
    {
        "observation",
        "similarity",
        "simulator",
        "statistics",
        "tick",
    },
    {"session", "identify", "planning", "benchmark", "view"},
    {"cli", "commands", "ros"},
)
RANK = {part: rank for rank, parts in enumerate(LAYERS) for part in parts}
ROS_FREE = {part for part, rank in RANK.items() if rank <= RANK["simulator"]}


def top_level_parts() -> list[str]:
    return sorted(module.name for module in pkgutil.iter_modules([str(SOURCE)]))


def imported_parts(file: Path) -> set[str]:
    """Return the parts of the package that the source in `file` imports when it runs."""
    inside = file.relative_to(ROOT).with_suffix("").parts[:-1]
    tree = ast.parse(file.read_text(encoding="utf-8"), str(file))
    for_types_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for statement in node.body
        for inner in ast.walk(statement)
    }
    modules = set()
    for node in ast.walk(tree):
        if id(node) in for_types_only:
            continue
        if isinstance(node, ast.Import):
            modules.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(inside[: len(inside) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, [base, node.module]))
            modules.add(module)
            modules.update(f"{module}.{alias.name}" for alias in node.names)
    names = (module.split(".") for module in modules)
    return {name[1] for name in names if name[0] == "needle_sim_ros" and len(name) > 1} & set(RANK)


@functools.cache
def import_graph() -> dict[str, set[str]]:
    graph: dict[str, set[str]] = {}
    for part in top_level_parts():
        folder = SOURCE / part
        files = sorted(folder.rglob("*.py")) if folder.is_dir() else [SOURCE / f"{part}.py"]
        graph[part] = set().union(*map(imported_parts, files)) - {part}
    return graph


def test_package_xml_and_setup_py_agree():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    assert package.get("format") == "3"
    assert package.findtext("name") == "needle_sim_ros"
    assert package.findtext("export/build_type") == "ament_python"
    version = re.search(r'version="([^"]+)"', setup)
    assert version is not None
    assert package.findtext("version") == version.group(1) == needle_sim_ros.__version__
    maintainer = package.find("maintainer")
    assert maintainer is not None
    assert f'maintainer_email="{maintainer.get("email")}"' in setup


def test_every_part_has_a_layer():
    assert set(top_level_parts()) <= set(RANK)


@pytest.mark.parametrize("part", top_level_parts())
def test_imports_point_one_way(part):
    upward = {other for other in import_graph()[part] if RANK[other] > RANK[part]}
    assert not upward, f"{part} imports {sorted(upward)}"


def test_imports_make_no_circle():
    graph = dict(import_graph())
    while graph:
        leaves = [part for part, needed in graph.items() if not needed & set(graph)]
        assert leaves, f"circular imports among {sorted(graph)}"
        for part in leaves:
            del graph[part]


@pytest.mark.parametrize("part", top_level_parts())
def test_part_imports(part):
    importlib.import_module(f"needle_sim_ros.{part}")


def test_nothing_from_the_simulator_down_imports_ros():
    parts = sorted(ROS_FREE & set(top_level_parts()))
    script = (
        "import importlib, pkgutil, sys\n"
        f"for part in {parts!r}:\n"
        "    module = importlib.import_module('needle_sim_ros.' + part)\n"
        "    for found in pkgutil.walk_packages(getattr(module, '__path__', []),\n"
        "                                       module.__name__ + '.'):\n"
        "        importlib.import_module(found.name)\n"
        "roots = {name.split('.')[0] for name in sys.modules}\n"
        "print(*sorted(roots & {'rclpy', 'geometry_msgs', 'std_msgs', 'ament_index_python'}))\n"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert loaded.stdout.split() == []


def test_importing_the_package_is_cheap():
    script = (
        "import sys, needle_sim_ros\n"
        "print(*sorted({'numpy', 'scipy', 'skfem', 'rclpy', 'matplotlib'} & set(sys.modules)))\n"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert loaded.stdout.split() == []


@pytest.mark.parametrize("name", sorted(set(needle_sim_ros.__all__) - {"__version__"}))
def test_public_name(name):
    assert getattr(needle_sim_ros, name).__name__ == name
    assert name in dir(needle_sim_ros)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Needle'"):
        needle_sim_ros.Needle  # noqa: B018
