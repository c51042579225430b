# SPDX-License-Identifier: Apache-2.0
"""Where the files that come with the package are: scenes and recorded sessions."""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from needle_sim_ros.errors import SceneError

_PACKAGE = "needle_sim_ros"


def roots() -> Iterator[Path]:
    """Yield the folders that may hold `config` and `bags`, the nearest first.

    A source checkout, the environment's share folder (pip), and the share folders of
    the sourced ROS workspaces (colcon).
    """
    yield Path(__file__).resolve().parent.parent
    yield Path(sys.prefix) / "share" / _PACKAGE
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / _PACKAGE


def scene_names() -> list[str]:
    """Return the bare names of the scenes that come with the package."""
    for root in roots():
        folder = root / "config" / "scenes"
        if folder.is_dir():
            return sorted(p.stem for p in folder.glob("*.yaml"))
    return []


def find_scene(source: str | Path) -> Path:
    """Return the file of a scene given by path or by bare name.

    Raises
    ------
    SceneError
        When there is no such file, with the names that exist.
    """
    path = Path(source).expanduser()
    if path.is_file():
        return path
    bare = str(source)
    if path.suffix == "" and len(path.parts) == 1:
        for root in roots():
            candidate = root / "config" / "scenes" / f"{bare}.yaml"
            if candidate.is_file():
                return candidate
    names = scene_names()
    near = difflib.get_close_matches(bare, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise SceneError(
        "scene", bare, f"no such file, nor a scene of this package ({', '.join(names)}){hint}"
    )
