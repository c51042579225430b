# SPDX-License-Identifier: Apache-2.0
"""Everything that makes a ROS node the simulator: built on a node, and taken off again.

The plain node and the managed node differ only in when they do this.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros import garbage, interaction_parameters, parameters
from needle_sim_ros.ros.awake import Awake
from needle_sim_ros.ros.clock_loop import ClockLoop
from needle_sim_ros.ros.commands import StageCommands
from needle_sim_ros.ros.diagnostics import Diagnostics
from needle_sim_ros.ros.garbage import Garbage
from needle_sim_ros.ros.identification import Identification
from needle_sim_ros.ros.inputs import Inputs
from needle_sim_ros.ros.outlet import Naming
from needle_sim_ros.ros.outputs import Outputs
from needle_sim_ros.ros.own_core import OwnCore
from needle_sim_ros.ros.planning import Planning
from needle_sim_ros.ros.plant import ROOM, Plant
from needle_sim_ros.ros.priority import raise_middleware, take_priority, uninterrupted
from needle_sim_ros.ros.regularly import Pause, Regularly
from needle_sim_ros.ros.services import Services
from needle_sim_ros.ros.visualization import Visualization
from needle_sim_ros.session import channels
from needle_sim_ros.session.channels import Channel

_DIAGNOSTICS_PERIOD = 1.0  # s
_HEARERS_PERIOD = 0.05  # s, after which a new subscriber is noticed
_CLOCK_POLL = 1e-3  # s, how often a clock from outside is looked at
_QUIET = 1.0  # s between two warnings about commands


class Simulation:
    """Plant, clock loop, topics, services and parameters on a node.

    Parameters
    ----------
    node : Node
        Any node; takes its parameters from it.

    Attributes
    ----------
    plant : Plant
    loop : ClockLoop
    outputs : Outputs
    visualization : Visualization
    priority : str
        With which the clock loop runs, and on what processors.
    active : bool
        Whether it may tick; a managed node that is not activated may not.

    Raises
    ------
    NeedleSimError
        When parameters or scene cannot be used, or the record folder cannot be written.
        What was put on the node until then is taken off again.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._undo: list[Callable[[], object]] = []
        self._beside: list[Callable[[], object]] = []  # ends what runs beside the ticks
        self._lost = 0
        self._quiet_until = 0.0
        self._inputs: Inputs | None = None
        self.active = True
        self.priority = "normal"
        try:
            self._build()
        except BaseException:
            self._take_off()
            raise

    def start(self, on_error: Callable[[BaseException], object] = lambda error: None) -> None:
        """Begin to tick; `on_error` is told when ticking ends by an unexpected error."""

        def failed(error: BaseException) -> None:
            self._node.get_logger().fatal(f"the clock loop ended: {error!r}")
            on_error(error)

        if self._settings.keep_awake:
            self._beside.append(Awake(self._node.get_logger().warning).end)
        self.loop.start(failed, self._take_priority)
        scene, rate = self.plant.scene.name, 1 / self.plant.period
        self._node.get_logger().info(f"simulating {scene} at {rate:g} Hz")

    def close(self) -> None:
        """Stop ticking, take no commands, finish the recording; needs a valid context."""
        while self._beside:
            self._beside.pop()()
        self.loop.stop()
        if self._inputs is not None:
            self._inputs.stop()
        if self.plant.recording is not None:
            folder, status = self.plant.stop_recording()
            self._node.get_logger().info(
                f"recorded {status.written} messages in {folder}"
                + (f", lost {status.lost}: {status.error}" if status.error else "")
            )

    def destroy(self) -> None:
        """Close, and take everything but the parameters off the node."""
        self.close()
        self._take_off()

    def _take_off(self) -> None:
        while self._undo:
            self._undo.pop()()

    def _build(self) -> None:
        node = self._node
        self._settings = settings = parameters.declare(node)
        self.record_folder = settings.record_folder
        self.outputs = Outputs(node, settings.publish_clock)
        self._undo.append(self.outputs.destroy)
        everything = (*channels.INPUTS, *channels.OUTPUTS, *channels.RECORDS)
        naming = Naming(
            settings.tissue_frame,
            settings.base_frame,
            {channel: self._resolved(channel) for channel in everything},
            partial(parameters.recorded, node),
        )
        commands = StageCommands(settings.tissue_frame, settings.limits)
        self.plant = Plant(
            settings.scene, settings.period, commands, naming, self.outputs.sinks, self._warn
        )
        self._core: OwnCore | None = None
        if settings.dedicated_core >= 0:
            self._core = OwnCore(settings.dedicated_core, settings.period)
            self._undo.append(self._core.give_back)
        self.loop = self._make_loop()
        self.plant.time_left = lambda: self.loop.time_left
        # A thread that holds the interpreter lock must not be held up by other processes
        self.plant.greet = lambda: take_priority(max(0.0, settings.realtime_priority - 1))
        if settings.record:
            record = self.record_folder
            folder = self.plant.start_recording(record.path(), record.split)
            node.get_logger().info(f"recording in {folder}")
            self._undo.append(self.close)
        self._inputs = inputs = Inputs(node, self.plant, self._warn)
        self._undo.append(inputs.destroy)
        services = Services(
            node,
            self.plant,
            self.loop,
            self.outputs.refresh,
            lambda: self.record_folder,
            lambda: self.active,
        )
        self._undo.append(services.destroy)
        name = node.get_fully_qualified_name()[1:]
        planning = Planning(node, self.plant, settings.tissue_frame)
        self._beside.append(planning.close)
        self._undo.append(planning.close)
        self.visualization = Visualization(node, self.plant, settings.tissue_frame)
        self._beside.append(self.visualization.close)
        self._undo.append(self.visualization.destroy)
        identification = Identification.wanted(node, self.plant)
        if identification is not None:
            self._beside.append(identification.close)
            self._undo.append(identification.destroy)
        self._diagnostics = Diagnostics(
            self.plant, self.loop, inputs.publishers, lambda: self.priority, name
        )
        regularly = Regularly(
            {
                self.outputs.refresh: _HEARERS_PERIOD,
                self._diagnose: _DIAGNOSTICS_PERIOD,
                Garbage(self.plant.give_way).collect: garbage.PERIOD,
            },
            partial(self.plant.give_way, ROOM),
            lambda error: node.get_logger().error(f"not done this time: {error!r}"),
        )
        self._beside.append(regularly.close)
        self._undo.append(regularly.close)

        def validate(changes: list[Parameter]) -> SetParametersResult:
            self.plant.give_way()
            return parameters.validate(node, self, changes)

        node.add_on_set_parameters_callback(validate)
        self._undo.append(partial(node.remove_on_set_parameters_callback, validate))
        node.add_post_set_parameters_callback(self._parameters_set)
        self._undo.append(partial(node.remove_post_set_parameters_callback, self._parameters_set))

    def _take_priority(self) -> None:
        priority = self._settings.realtime_priority
        self.priority = take_priority(priority)
        raise_middleware(priority - 1)
        if self._settings.keep_awake:
            self.priority += ", processors kept awake"
        if self._core is not None:
            self.priority += ", " + self._core.take()

    def _resolved(self, channel: Channel) -> str:
        name: str = self._node.resolve_topic_name(channel.name)
        return name

    def _make_loop(self) -> ClockLoop:
        period, tick = self._settings.period, uninterrupted(self.plant.tick)
        if not self._node.get_parameter("use_sim_time").value:
            sleep = time.sleep if self._core is None else self._core.wait
            return ClockLoop(tick, period, sleep=sleep)
        clock = self._node.get_clock()
        return ClockLoop(
            tick,
            period,
            now=lambda: int(clock.now().nanoseconds),
            sleep=lambda remaining: time.sleep(min(remaining, _CLOCK_POLL)),
        )

    def _warn(self, message: str) -> None:
        # rclpy's own throttle looks up who calls, through the stack, before it asks for the time
        now = time.monotonic()
        if now >= self._quiet_until:
            self._quiet_until = now + _QUIET
            count = self.plant.commands.rejected_count
            self._node.get_logger().warning(f"{message} ({count} so far)")

    def _parameters_set(self, changes: list[Parameter]) -> None:
        node = self._node
        self.plant.commands.limits = parameters.current_limits(node)
        self.record_folder = replace(
            self.record_folder,
            folder=parameters.current_record(node),
            split=parameters.current_split(node),
        )
        laws = interaction_parameters.changes_in(self.plant.current_scene, changes)
        if laws:
            try:
                self.plant.change_interaction(laws)
            except NeedleSimError as error:  # validated before: somebody was faster
                node.get_logger().error(f"interaction not changed: {error}")
        for change in changes:
            if not change.name.startswith(interaction_parameters.PREFIX):
                self.plant.event("parameter", name=change.name, value=change.value)

    def _diagnose(self, pause: Pause) -> None:
        data = serialize_message(self._diagnostics.message(pause))
        self.outputs.sinks[channels.DIAGNOSTICS].publish(data)
        self.plant.record(channels.DIAGNOSTICS, data)
        status = self.plant.recorder_status
        if self.plant.recording is not None and status.lost > self._lost:
            self._node.get_logger().error(f"{status.lost} messages not recorded: {status.error}")
        self._lost = status.lost
