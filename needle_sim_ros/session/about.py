# SPDX-License-Identifier: Apache-2.0
"""Versions of this package and of what its numbers depend on."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from needle_sim_ros import __version__
from needle_sim_ros.interaction import compiled_balance
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.libraries import choose

_LIBRARIES = ("numpy", "scipy", "scikit-fem", "pypardiso", "mcap", "rclpy")


def versions(scene: Scene | None = None) -> dict[str, str]:
    """Return the versions that a bit-identical replay needs, by name.

    With a scene also the library that factorises its tissue here.
    """
    compiled = "yes" if compiled_balance.available() else "no"
    if scene is None:
        return {**_versions(), "compiled": compiled}
    return {
        **_versions(),
        "compiled": compiled,
        "factorization": choose(scene.solver.factorization, scene.dimension).name,
    }


@cache
def _versions() -> dict[str, str]:
    found = {"package_version": __version__, "python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            continue
    found["machine"] = platform.machine()
    return found
