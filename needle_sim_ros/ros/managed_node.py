# SPDX-License-Identifier: Apache-2.0
"""The node `needle_sim`, managed: for stacks that bring their nodes up in order.

configure reads the parameters, builds the scene and factorises its tissue; activate
ticks; deactivate stands still and keeps the state; cleanup forgets everything. See
https://design.ros2.org/articles/node_lifecycle.html.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.simulation import Simulation

_Return = TransitionCallbackReturn


class ManagedSimNode(LifecycleNode):
    """The same simulation under the node lifecycle.

    Parameters
    ----------
    **options
        Passed on to `rclpy.lifecycle.LifecycleNode`.

    Attributes
    ----------
    simulation : Simulation or None
        None while it is not configured.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("needle_sim", **options)
        self.simulation: Simulation | None = None
        self._on_error: Callable[[BaseException], object] = lambda error: None

    def start(self, on_error: Callable[[BaseException], object] = lambda error: None) -> None:
        """Be told when ticking ends by an unexpected error; ticks only once activated."""
        self._on_error = on_error

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build; a parameter that cannot be used leaves the node unconfigured."""
        try:
            self.simulation = Simulation(self)
        except NeedleSimError as error:
            self.get_logger().error(str(error))
            return _Return.FAILURE
        self.simulation.active = False
        self.simulation.loop.pause()
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Tick, from where it stood."""
        simulation = self._built()
        if not simulation.loop.running:
            simulation.start(self._on_error)
        simulation.active = True
        simulation.loop.resume()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stand still after the tick under way."""
        simulation = self._built()
        simulation.active = False
        simulation.loop.pause()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Finish the recording and forget everything."""
        self.close()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Finish the recording."""
        self.close()
        return super().on_shutdown(state)

    def close(self) -> None:
        """Stop ticking, finish the recording, and take the simulation off the node."""
        simulation, self.simulation = self.simulation, None
        if simulation is not None:
            simulation.destroy()

    def _LifecycleNodeMixin__change_state(self, transition_id: int) -> TransitionCallbackReturn:
        # rclpy raises in its executor, which ends the node, when somebody asks for a
        # transition that the present state does not have; there is no public hook.
        change: Any = getattr(super(), "_LifecycleNodeMixin__change_state")  # noqa: B009
        try:
            return change(transition_id)
        except RCLError as error:
            self.get_logger().warning(f"transition {transition_id} refused: {error}")
            return _Return.FAILURE

    def _built(self) -> Simulation:
        if self.simulation is None:
            raise NeedleSimError("not configured")
        return self.simulation
