# SPDX-License-Identifier: Apache-2.0
"""A flexible needle entering soft tissue, simulated in real time.

The public names are imported on first use, so that importing the package is cheap and needs
neither scipy nor ROS.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from needle_sim_ros.command import BaseCommand
    from needle_sim_ros.errors import (
        CommandError,
        NeedleSimError,
        SceneError,
        SessionError,
        SolverError,
    )
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.scene import Scene
    from needle_sim_ros.simulator import Simulator

__version__ = "0.1.0"

__all__ = [
    "BaseCommand",
    "CommandError",
    "NeedleSimError",
    "Observation",
    "Scene",
    "SceneError",
    "SessionError",
    "Simulator",
    "SolverError",
    "__version__",
]

_HOME = {
    "BaseCommand": "command",
    "CommandError": "errors",
    "NeedleSimError": "errors",
    "Observation": "observation",
    "Scene": "scene",
    "SceneError": "errors",
    "SessionError": "errors",
    "Simulator": "simulator",
    "SolverError": "errors",
}


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
