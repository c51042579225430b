# SPDX-License-Identifier: Apache-2.0
"""The node `needle_sim`: topics, services and parameters around the plant."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import SetBool, Trigger

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros import parameters
from needle_sim_ros.ros.clock_loop import ClockLoop
from needle_sim_ros.ros.commands import StageCommands
from needle_sim_ros.ros.diagnostics import Diagnostics
from needle_sim_ros.ros.identification import Identification
from needle_sim_ros.ros.plant import Naming, Plant, Sink
from needle_sim_ros.session import channels
from needle_sim_ros.session.channels import Channel

_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
_BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_DIAGNOSTICS_PERIOD = 1.0  # s
_LARGEST_COMMAND = 1024  # bytes; a pose with a long frame id has some hundred
_CLOCK_POLL = 1e-3  # s, how often a clock from outside is looked at


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
            self._build()
        except BaseException:
            self.destroy_node()
            raise

    def _build(self) -> None:
        self._settings = settings = parameters.declare(self)
        self._record_folder = settings.record
        commands = StageCommands(settings.tissue_frame, settings.limits)
        everything = (*channels.INPUTS, *channels.OUTPUTS, *channels.RECORDS)
        naming = Naming(
            settings.tissue_frame,
            settings.base_frame,
            {channel: self._resolved(channel) for channel in everything},
            parameters.recorded(self),
        )
        self.sinks = self._make_sinks(settings.publish_clock)
        self.plant = Plant(
            settings.scene, settings.period, commands, naming, self.sinks, self._warn
        )
        self.loop = self._make_loop()
        self._diagnostics = Diagnostics(self.plant, self.loop, self.get_fully_qualified_name()[1:])
        if settings.record:
            self.plant.start_recording(Path(settings.record))
            self.get_logger().info(f"recording in {self.plant.recording}")
        self._lost = 0
        self.identification = Identification.wanted(self, self.plant)
        self._subscribe()
        self.create_service(Trigger, "~/reset", self._reset)
        self.create_service(Trigger, "~/step", self._step)
        self.create_service(SetBool, "~/pause", self._pause)
        self.create_service(SetBool, "~/record", self._record)
        self.add_on_set_parameters_callback(partial(parameters.validate, self))
        self.add_post_set_parameters_callback(self._parameters_set)
        self.create_timer(_DIAGNOSTICS_PERIOD, self._diagnose, clock=Clock())

    def start(self, on_error: Callable[[BaseException], object] = lambda error: None) -> None:
        """Begin to tick; `on_error` is told when ticking ends by an unexpected error."""

        def failed(error: BaseException) -> None:
            self.get_logger().fatal(f"the clock loop ended: {error!r}")
            on_error(error)

        self.loop.start(failed)

    def close(self) -> None:
        """Stop ticking and finish the recording; the context must still be valid."""
        self.loop.stop()
        if self.identification is not None:
            self.identification.close()
        if self.plant.recording is not None:
            folder, status = self.plant.stop_recording()
            self.get_logger().info(
                f"recorded {status.written} messages in {folder}"
                + (f", lost {status.lost}: {status.error}" if status.error else "")
            )

    def _resolved(self, channel: Channel) -> str:
        name: str = self.resolve_topic_name(channel.name)
        return name

    def _make_sinks(self, publish_clock: bool) -> dict[Channel, Sink]:
        published = [*channels.OUTPUTS, *channels.RECORDS]
        if publish_clock:
            published.append(channels.CLOCK)
        sinks = {}
        for channel in published:
            package, _, kind = channel.type.split("/")
            message = getattr(import_module(f"{package}.msg"), kind)
            publisher = self.create_publisher(message, channel.name, _RELIABLE)
            sinks[channel] = Sink(publisher.get_subscription_count, publisher.publish)
        return sinks

    def _make_loop(self) -> ClockLoop:
        period = self._settings.period
        if not self.get_parameter("use_sim_time").value:
            return ClockLoop(self.plant.tick, period)
        clock = self.get_clock()
        return ClockLoop(
            self.plant.tick,
            period,
            now=lambda: int(clock.now().nanoseconds),
            sleep=lambda remaining: time.sleep(min(remaining, _CLOCK_POLL)),
        )

    def _subscribe(self) -> None:
        for channel, message, take in (
            (channels.BASE_POSE, PoseStamped, self._take_pose),
            (channels.STAGE_VELOCITY, TwistStamped, self._take_velocity),
        ):
            self.create_subscription(message, channel.name, take, _BEST_EFFORT, raw=True)

    def _take_pose(self, data: bytes) -> None:
        message = self._read(data, PoseStamped, channels.BASE_POSE)
        if message is not None:
            p, q = message.pose.position, message.pose.orientation
            reason = self.plant.commands.pose(
                (p.x, p.y, p.z),
                (q.x, q.y, q.z, q.w),
                message.header.frame_id,
                self.plant.time,
                self.plant.position,
            )
            self._warn_rejected(channels.BASE_POSE, reason)

    def _take_velocity(self, data: bytes) -> None:
        message = self._read(data, TwistStamped, channels.STAGE_VELOCITY)
        if message is not None:
            v, w = message.twist.linear, message.twist.angular
            reason = self.plant.commands.velocity(
                (v.x, v.y, v.z), (w.x, w.y, w.z), message.header.frame_id, self.plant.time
            )
            self._warn_rejected(channels.STAGE_VELOCITY, reason)

    def _read(self, data: bytes, kind: Any, channel: Channel) -> Any:
        """Return the message, recorded as it came, or None for bytes that are none."""
        try:
            message = deserialize_message(data, kind)
        except Exception:
            self._warn_rejected(channel, self.plant.commands.unreadable())
            return None
        if len(data) > _LARGEST_COMMAND or "\ufffd" in message.header.frame_id:
            # Text that is no UTF-8, or slack after the message, would end other readers.
            data = serialize_message(message)
        self.plant.record(channel, data)
        return message

    def _warn_rejected(self, channel: Channel, reason: str | None) -> None:
        if reason is not None:
            self._warn(f"command on {channel.name} ignored: {reason}")

    def _warn(self, message: str) -> None:
        count = self.plant.commands.rejected_count
        self.get_logger().warning(f"{message} ({count} so far)", throttle_duration_sec=1.0)

    def _status(self) -> str:
        plant = self.plant
        return json.dumps(
            {
                "time": plant.time,
                "ticks": plant.ticks,
                "commands_received": plant.commands.received,
                "commands_rejected": plant.commands.rejected_count,
                "paused": self.loop.paused,
            }
        )

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.plant.reset()
        response.success, response.message = True, self._status()
        return response

    def _step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self.loop.paused:
            response.message = "not paused: call ~/pause with true first"
            return response
        before = self.plant.total_ticks
        self.plant.tick()
        response.success = self.plant.total_ticks > before
        response.message = self._status() if response.success else self.plant.last_failure
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data != self.loop.paused:
            if request.data:
                self.loop.pause()
            self.plant.event("paused" if request.data else "resumed")
            if not request.data:
                self.loop.resume()
        response.success, response.message = True, self._status()
        return response

    def _record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                folder = self.plant.start_recording(Path(self._record_folder or "."))
                response.message = str(folder)
            else:
                folder, status = self.plant.stop_recording()
                response.message = f"{folder}: {status.written} messages"
                if status.error:
                    response.message += f", {status.lost} lost: {status.error}"
        except NeedleSimError as error:
            response.message = str(error)
            return response
        response.success = True
        return response

    def _parameters_set(self, changes: list[Parameter]) -> None:
        self.plant.commands.limits = parameters.current_limits(self)
        for change in changes:
            if change.name == "record":
                self._record_folder = change.value
            self.plant.event("parameter", name=change.name, value=change.value)

    def _diagnose(self) -> None:
        sink = self.sinks[channels.DIAGNOSTICS]
        data = serialize_message(self._diagnostics.message())
        sink.publish(data)
        self.plant.record(channels.DIAGNOSTICS, data)
        status = self.plant.recorder_status
        if self.plant.recording is not None and status.lost > self._lost:
            self.get_logger().error(f"{status.lost} messages not recorded: {status.error}")
        self._lost = status.lost
