# SPDX-License-Identifier: Apache-2.0
"""Members that are worked out when first read."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    lazily = cached_property
else:

    class lazily:
        """`functools.cached_property` without the lock that it takes before Python 3.12.

        Two threads that read at once may both work a member out; they find the same. A tick
        reads a dozen, and the lock was a fiftieth of it.
        """

        def __init__(self, function: Any) -> None:
            self._function = function
            self.__doc__ = function.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self._name = name

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            value = instance.__dict__[self._name] = self._function(instance)
            return value
