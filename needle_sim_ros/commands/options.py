# SPDX-License-Identifier: Apache-2.0
"""Arguments that several subcommands share, and what they stand for."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene


def examples(lines: Sequence[str]) -> str:
    """Return calls, given without the program's name, as they stand below a help text."""
    return "\n".join(["examples:", *(f"  needle_sim {line}" for line in lines)])


def add_bag(parser: argparse.ArgumentParser) -> None:
    """Add ``BAG``, a recorded session."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a session's folder or MCAP file")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json FILE``."""
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the result as JSON")


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add ``--set KEY=VALUE``, which may be given several times."""
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="overrides",
        help="change one value of the scene, e.g. --set solver.dynamics=quasi_static;"
        " may be given several times",
    )


def add_mapping(parser: argparse.ArgumentParser) -> None:
    """Add ``--topic ROLE:=NAME`` and ``--mapping FILE`` for bags recorded by others."""
    parser.add_argument(
        "--topic",
        metavar="ROLE:=NAME",
        action="append",
        default=[],
        dest="topics",
        help="topic of a bag recorded by others: base_pose, wrench, markers or tip_pose;"
        " may be given several times",
    )
    parser.add_argument(
        "--mapping",
        metavar="FILE",
        type=Path,
        help="YAML with topics, frames, bias and sign of the sensor (doc/replay.md)",
    )


def parse_overrides(pairs: Sequence[str]) -> dict[str, object]:
    """Read ``KEY=VALUE`` pairs, each value as YAML.

    Raises
    ------
    NeedleSimError
        On a pair without ``=``, an empty key, or a value that is not YAML.
    """
    overrides: dict[str, object] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        key = key.strip()
        if not equals or not key:
            raise NeedleSimError(f"--set {pair}: must be KEY=VALUE")
        try:
            overrides[key] = _number(yaml.safe_load(text))
        except yaml.YAMLError:
            raise NeedleSimError(f"--set {pair}: {text!r} is not a YAML value") from None
    return overrides


def _number(value: object) -> object:
    """Read what YAML 1.1 takes for text although it is a number: ``1e-3``, ``2E5``."""
    if isinstance(value, list):
        return [_number(item) for item in value]
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value


def load_scene(name: str, pairs: Sequence[str]) -> Scene:
    """Load a scene by file or bare name, with ``--set`` applied."""
    overrides = parse_overrides(pairs)
    from needle_sim_ros.scene import Scene

    return Scene.load(name, overrides)
