# SPDX-License-Identifier: Apache-2.0
"""Where the files that come with the package are: scenes and recorded sessions."""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from needle_sim_ros.errors import SceneError, SessionError

_PACKAGE = Path(__file__).resolve().parent


def roots() -> Iterator[Path]:
    """Yield the folders that hold `config` and `bags`, the nearest first.

    A source checkout; ``share/needle_sim_ros`` of the prefix the package lies in, whether
    pip or colcon put it there; the share folders of the sourced ROS workspaces. Found from
    the package's own place, so that neither an ament index nor a sourced workspace is needed.
    """
    name = _PACKAGE.name
    workspaces = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    candidates = [
        _PACKAGE.parent,
        # <prefix>/lib/python3.x/site-packages, Debian's dist-packages, `pip install --target`
        *(prefix / "share" / name for prefix in _PACKAGE.parents),
        Path(sys.prefix) / "share" / name,
        *(Path(prefix) / "share" / name for prefix in workspaces if prefix),
    ]
    for folder in dict.fromkeys(candidates):
        if (folder / "package.xml").is_file():
            yield folder


def bags_directory() -> Path:
    """Return the folder of the recorded sessions that come with the package.

    Raises
    ------
    SessionError
        When the package was installed without them.
    """
    for root in roots():
        if (root / "bags").is_dir():
            return root / "bags"
    raise SessionError("no bags folder came with this installation: reinstall needle_sim_ros")


def scene_names() -> list[str]:
    """Return the bare names of the scenes that come with the package."""
    for root in roots():
        folder = root / "config" / "scenes"
        if folder.is_dir():
            return sorted(p.stem for p in folder.glob("*.yaml"))
    return []


def find_mesh(source: str) -> Path:
    """Return a mesh file given by path, or by its name among those of the package.

    Raises
    ------
    SceneError
        When there is no such file.
    """
    path = Path(source).expanduser()
    if path.is_file():
        return path
    names: list[str] = []
    for root in roots():
        folder = root / "config" / "meshes"
        if (folder / source).is_file():
            return folder / source
        names += sorted(p.name for p in folder.glob("*.msh")) if folder.is_dir() else []
    known = ", ".join(dict.fromkeys(names)) or "none"
    raise SceneError("tissue.mesh.file", source, f"no such file, nor one of this package ({known})")


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
