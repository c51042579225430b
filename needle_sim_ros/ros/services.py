# SPDX-License-Identifier: Apache-2.0
"""The node's services: pause, step, reset, record; failures say why."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.clock_loop import ClockLoop
from needle_sim_ros.ros.plant import Plant
from needle_sim_ros.ros.record_folder import RecordFolder

_Answer = Callable[[Any, Any], Any]
_NOT_ACTIVE = "the node is not active: activate it first"


class Services:
    """Offers the services of a simulation.

    Parameters
    ----------
    node : Node
        Offers them.
    plant : Plant
        What ticks.
    loop : ClockLoop
        What makes it tick.
    before_step : callable
        Called before each single step.
    record : callable
        Gives where and how to record now.
    active : callable
        Whether ticks are allowed.
    """

    def __init__(
        self,
        node: Node,
        plant: Plant,
        loop: ClockLoop,
        before_step: Callable[[], object],
        record: Callable[[], RecordFolder],
        active: Callable[[], bool],
    ) -> None:
        self._node = node
        self._plant = plant
        self._loop = loop
        self._before_step = before_step
        self._record_now = record
        self._active = active
        self._services = [
            node.create_service(kind, name, self._beside_ticks(answer))
            for kind, name, answer in (
                (Trigger, "~/reset", self._reset),
                (Trigger, "~/step", self._step),
                (SetBool, "~/pause", self._pause),
                (SetBool, "~/record", self._record),
            )
        ]

    def destroy(self) -> None:
        """Take the services off the node."""
        for service in self._services:
            self._node.destroy_service(service)

    def _beside_ticks(self, answer: _Answer) -> _Answer:
        """Let an answer begin where a tick has ended, by a thread that others do not hold up."""

        def answered(request: Any, response: Any) -> Any:
            self._plant.give_way()
            return answer(request, response)

        return answered

    def _status(self) -> str:
        plant = self._plant
        return json.dumps(
            {
                "time": plant.time,
                "ticks": plant.ticks,
                "commands_received": plant.commands.received,
                "commands_rejected": plant.commands.rejected_count,
                "paused": self._loop.paused,
            }
        )

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._plant.reset()
        response.success, response.message = True, self._status()
        return response

    def _step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._active():
            response.message = _NOT_ACTIVE
            return response
        if not self._loop.paused:
            response.message = "not paused: call ~/pause with true first"
            return response
        self._before_step()
        before = self._plant.total_ticks
        self._plant.tick()
        response.success = self._plant.total_ticks > before
        response.message = self._status() if response.success else self._plant.last_failure
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if not self._active():
            response.message = _NOT_ACTIVE
            return response
        if request.data != self._loop.paused:
            if request.data:
                self._loop.pause()
            self._plant.event("paused" if request.data else "resumed")
            if not request.data:
                self._loop.resume()
        response.success, response.message = True, self._status()
        return response

    def _record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                record = self._record_now()
                response.message = str(self._plant.start_recording(record.path(), record.split))
            else:
                folder, status = self._plant.stop_recording()
                response.message = f"{folder}: {status.written} messages"
                if status.error:
                    response.message += f", {status.lost} lost: {status.error}"
        except NeedleSimError as error:
            response.message = str(error)
            return response
        response.success = True
        return response
