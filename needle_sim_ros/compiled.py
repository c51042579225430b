# SPDX-License-Identifier: Apache-2.0
"""Whether what is compiled is used. Everything in C is there in numpy too."""

from __future__ import annotations

import os

SWITCH = "NEEDLE_SIM_COMPILED"


def wanted() -> bool:
    """Return whether the environment allows compiled code: ``NEEDLE_SIM_COMPILED`` is not off."""
    return os.environ.get(SWITCH, "on").lower() != "off"
