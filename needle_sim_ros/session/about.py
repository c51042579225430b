# SPDX-License-Identifier: Apache-2.0
"""Versions of this package and of what its numbers depend on."""

from __future__ import annotations

import platform
import re
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGE = "needle_sim_ros"
_LIBRARIES = ("numpy", "scipy", "scikit-fem", "pypardiso", "numba", "mcap", "rclpy")


def package_version() -> str:
    """Return the version of this package, installed or in a source checkout."""
    try:
        return version(_PACKAGE)
    except PackageNotFoundError:
        manifest = Path(__file__).resolve().parents[2] / "package.xml"
        match = (
            re.search(r"<version>(.*?)</version>", manifest.read_text())
            if (manifest.is_file())
            else None
        )
        return match[1] if match else "unknown"


@cache
def versions() -> dict[str, str]:
    """Return the versions that a bit-identical replay needs, by name."""
    found = {"package_version": package_version(), "python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            continue
    found["machine"] = platform.machine()
    return found
