# SPDX-License-Identifier: Apache-2.0
"""The mesh file of a scene inside its session, so that a replay needs nothing else."""

from __future__ import annotations

import atexit
import tempfile
from collections.abc import Mapping
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from needle_sim_ros.errors import SessionError
from needle_sim_ros.resources import find_mesh
from needle_sim_ros.scene import Scene

# the rest of the name is the suffix, by which meshio knows the format
MESH_FILE = "tissue_mesh"


def mesh_attachment(scene: Scene) -> tuple[str, bytes] | None:
    """Return name and bytes of the attachment of a scene, None where it has no mesh file.

    Raises
    ------
    SceneError, SessionError
        When the file is not there, or cannot be read.
    """
    if scene.tissue.mesh.file is None:
        return None
    path = find_mesh(scene.tissue.mesh.file)
    try:
        return MESH_FILE + path.suffix, path.read_bytes()
    except OSError as error:
        raise SessionError(f"cannot read the mesh {path}: {error.strerror}") from error


def attached_mesh(attachments: Mapping[str, bytes]) -> tuple[str, bytes] | None:
    """Return name and bytes of the mesh among the attachments of a session, if it has one."""
    named = [name for name in attachments if Path(name).stem == MESH_FILE]
    return (named[0], attachments[named[0]]) if named else None


def recorded_scene(text: str, mesh: tuple[str, bytes] | None) -> Scene:
    """Return the scene of a session, its mesh out of the session and not from elsewhere.

    Parameters
    ----------
    text : str
        YAML.
    mesh : (str, bytes) or None
        The attachment; None takes the file that the scene names.
    """
    scene = Scene.from_yaml(text)
    if mesh is None or scene.tissue.mesh.file is None:
        return scene
    name, data = mesh
    folder = _folder() / sha256(data).hexdigest()[:16]
    folder.mkdir(exist_ok=True)
    path = folder / name
    if not path.is_file():
        path.write_bytes(data)
    return scene.with_changes({"tissue.mesh.file": str(path)})


@lru_cache(maxsize=1)
def _folder() -> Path:
    """Return a folder that lasts as long as this process."""
    made = tempfile.TemporaryDirectory(prefix="needle_sim_mesh_")
    atexit.register(made.cleanup)
    return Path(made.name)
