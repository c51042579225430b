# SPDX-License-Identifier: Apache-2.0
"""Every error this package raises on purpose, under one root."""

from __future__ import annotations


class NeedleSimError(Exception):
    """Root of all errors of this package."""


class SceneError(NeedleSimError):
    """A scene that cannot be simulated.

    Parameters
    ----------
    key : str
        Dotted key of the scene, e.g. ``tissue.youngs_modulus``.
    value : object
        The value that was given.
    allowed : str
        What would have been accepted.
    """

    def __init__(self, key: str, value: object, allowed: str) -> None:
        self.key = key
        self.value = value
        self.allowed = allowed
        super().__init__(f"{key} = {value!r}: {allowed}")

    def __reduce__(self) -> tuple[type[SceneError], tuple[str, object, str]]:
        """Pickle by the three parts, so that it comes back from another process."""
        return type(self), (self.key, self.value, self.allowed)


class CommandError(NeedleSimError):
    """A base command that cannot be carried out; the state is unchanged."""


class SolverError(NeedleSimError):
    """A numerical failure inside a tick; the state is unchanged."""


class SessionError(NeedleSimError):
    """A recorded session that cannot be written or read."""
