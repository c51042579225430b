# SPDX-License-Identifier: Apache-2.0
"""Runs the node `needle_sim` until SIGINT or SIGTERM."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from typing import Any

from needle_sim_ros.errors import NeedleSimError

_SWITCH_INTERVAL = 1e-4  # s; the default of 5 ms lets another thread hold up several ticks


def main(args: list[str] | None = None, managed: bool = False) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit status.

    With `managed` it is a lifecycle node, which does nothing until it is configured.
    """
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    sys.setswitchinterval(_SWITCH_INTERVAL)
    # Threads of the linear algebra library cost more than they bring at these sizes, and
    # hold up ticks by milliseconds; it reads this when numpy is first imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Fast DDS would send to every subscriber within the tick; another thread can.
    os.environ.setdefault("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")
    import rclpy  # after the handlers: a signal during this import ends the node cleanly too
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import try_shutdown

    # With rclpy's own handlers the context would be gone before the recording is finished.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    try:
        return _run(stop, managed)
    finally:
        try_shutdown()


def _run(stop: threading.Event, managed: bool) -> int:
    import rclpy.logging

    from needle_sim_ros.ros.managed_node import ManagedSimNode
    from needle_sim_ros.ros.sim_node import SimNode
    from needle_sim_ros.ros.spinning import Spinning

    logger: Any = rclpy.logging.get_logger("needle_sim")
    try:
        node = ManagedSimNode() if managed else SimNode()
    except NeedleSimError as error:
        logger.fatal(str(error))
        return 1
    failures: list[BaseException] = []

    def failed(error: BaseException) -> None:
        failures.append(error)
        stop.set()

    def spun(error: BaseException | None) -> None:
        if error is None:
            stop.set()
            return
        logger.fatal(f"the executor ended: {error!r}")
        failed(error)

    # What exists now stays: a full garbage collection need not look through it each time.
    gc.collect()
    gc.freeze()
    gc.disable()  # see ros/garbage.py: it is collected in pieces, outside the ticks
    spinning = Spinning(node, "executor", spun)
    node.start(failed)
    stop.wait()
    if managed:  # its entities go with the simulation: nobody may be waiting on them
        spinning.stop()
    node.close()
    spinning.stop()
    node.destroy_node()
    return 1 if failures else 0


def main_managed(args: list[str] | None = None) -> int:
    """Run the managed node until SIGINT or SIGTERM; return the exit status."""
    return main(args, managed=True)


if __name__ == "__main__":
    sys.exit(main(managed="--managed" in sys.argv))
