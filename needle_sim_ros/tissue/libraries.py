# SPDX-License-Identifier: Apache-2.0
"""Which library factorises, and why: in 3D the fastest installed, or the one asked for."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from needle_sim_ros.errors import SceneError

_PACKAGES = {"pardiso": "pypardiso", "superlu": "scipy"}


@dataclass(frozen=True)
class Choice:
    """A library: its name in scenes, its package's version, and why it was taken."""

    name: str
    version: str
    reason: str

    def __str__(self) -> str:
        return f"{self.name} ({_PACKAGES[self.name]} {self.version})"


def choose(wanted: str = "auto", dimension: int = 3) -> Choice:
    """Return the library to use.

    Parameters
    ----------
    wanted : str
        ``solver.factorization`` of a scene.
    dimension : int
        Of the scene: in 2D the embedded library is fast enough, and what is installed beside
        it then changes no bit of a result.

    Raises
    ------
    SceneError
        When it is not installed, naming what is.
    """
    found = {name: _installed(package) for name, package in _PACKAGES.items()}
    here = [name for name, number in found.items() if number]
    if wanted == "auto" and dimension == 2:
        return Choice("superlu", found["superlu"], "always there, and fast enough in 2D")
    if wanted == "auto":
        name = here[0]
        reason = "the fastest installed"
        if name == "superlu":
            reason = "pip install needle_sim_ros[fast] brings a faster one"
        return Choice(name, found[name], reason)
    if wanted not in here:
        names = ", ".join(["auto", *here])
        raise SceneError(
            "solver.factorization",
            wanted,
            f"its library {_PACKAGES[wanted]} is not installed; here are {names}",
        )
    return Choice(wanted, found[wanted], "asked for by solver.factorization")


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
