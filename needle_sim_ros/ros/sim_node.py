# SPDX-License-Identifier: Apache-2.0
"""The node `needle_sim`, plain: ready as soon as it exists."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from needle_sim_ros.ros.clock_loop import ClockLoop
from needle_sim_ros.ros.outlet import Sink
from needle_sim_ros.ros.plant import Plant
from needle_sim_ros.ros.simulation import Simulation
from needle_sim_ros.session.channels import Channel


class SimNode(Node):
    """The node; :meth:`start` makes it tick.

    Parameters
    ----------
    **options
        Passed on to `rclpy.node.Node`: context, parameter overrides and so on.

    Raises
    ------
    NeedleSimError
        When parameters or scene cannot be used, or the record folder cannot be written.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("needle_sim", **options)
        try:
            self.simulation = Simulation(self)
        except BaseException:
            self.destroy_node()
            raise

    @property
    def plant(self) -> Plant:
        """What ticks."""
        return self.simulation.plant

    @property
    def loop(self) -> ClockLoop:
        """What makes it tick."""
        return self.simulation.loop

    @property
    def sinks(self) -> dict[Channel, Sink]:
        """Where messages are published."""
        return self.simulation.outputs.sinks

    def start(self, on_error: Callable[[BaseException], object] = lambda error: None) -> None:
        """Begin to tick; `on_error` is told when ticking ends by an unexpected error."""
        self.simulation.start(on_error)

    def close(self) -> None:
        """Stop ticking and finish the recording; the context must still be valid."""
        self.simulation.close()
