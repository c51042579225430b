# SPDX-License-Identifier: Apache-2.0
"""A node's callbacks in a thread of their own, from beginning to end."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future


class Spinning:
    """Spins a node until told to stop.

    rclpy's own shutdown takes away what the spinning thread may be about to use.

    Parameters
    ----------
    node : Node
    name : str
        Of the thread.
    on_end : callable, optional
        Told, in the thread, when spinning ends though nobody stopped it: the error, or None
        where the context was shut down.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        on_end: Callable[[BaseException | None], object] = lambda error: None,
    ) -> None:
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._on_end = on_end
        self._stopped = Future()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End after the callback under way; may be called again."""
        if not self._stopped.done():
            self._stopped.set_result(None)
            self._thread.join()
            self._executor.shutdown()

    def _run(self) -> None:
        try:
            self._executor.spin_until_future_complete(self._stopped)
        except ExternalShutdownException:
            self._on_end(None)
        except BaseException as error:
            self._on_end(error)
