# SPDX-License-Identifier: Apache-2.0
"""Say before installing anything why this Python cannot serve, and what to do about it.

Written so that old Pythons can still run it and print the message.
"""

import os
import platform
import sys

OLDEST, NEWEST = (3, 10), (3, 14)
LIBC = (2, 28)


def trouble():
    """Return the message to show, or None where this Python serves."""
    version = sys.version_info[:2]
    if not OLDEST <= version <= NEWEST:
        return (
            "{} is Python {}; the ROS 2 wheels exist for {} to {}.\n"
            "Name another one, for instance: make env PYTHON=python3.12\n"
            "(Debian, Ubuntu: apt install python3 python3-venv)"
        ).format(sys.executable, _dotted(version), _dotted(OLDEST), _dotted(NEWEST))
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError:
        return (
            "{} has no venv or no ensurepip module.\n"
            "Debian, Ubuntu: apt install python3-venv (or python{}-venv)\n"
            "Elsewhere name a complete Python: make env PYTHON=/path/to/python3"
        ).format(sys.executable, _dotted(version))
    apart = (
        "Without them the simulator still runs: pip install . (no extra), then needle_sim run.\n"
        "With ROS 2 Jazzy from apt (Ubuntu 24.04): colcon build."
    )
    if sys.platform != "linux" or platform.machine() not in ("x86_64", "AMD64"):
        return "The ROS 2 wheels exist for x86_64 Linux only; this is {} {}.\n{}".format(
            platform.system(), platform.machine(), apart
        )
    name, _, number = _libc().partition(" ")
    if name != "glibc" or tuple(map(int, number.split(".")[:2])) < LIBC:
        return "The ROS 2 wheels need glibc {} or newer; this system has {}.\n{}".format(
            _dotted(LIBC), _libc() or "another C library", apart
        )
    return None


def _dotted(version):
    return ".".join(map(str, version))


def _libc():
    try:
        return os.confstr("CS_GNU_LIBC_VERSION") or ""
    except (AttributeError, OSError, ValueError):
        return ""


if __name__ == "__main__":
    message = trouble()
    if message:
        sys.exit("\n" + message + "\n")
