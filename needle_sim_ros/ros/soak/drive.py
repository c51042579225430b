# SPDX-License-Identifier: Apache-2.0
"""The whole soak, part after part, each with nodes of its own."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.domain import free_domain
from needle_sim_ros.ros.own_core import why_not
from needle_sim_ros.ros.soak.endings import end_nodes
from needle_sim_ros.ros.soak.hostility import provoke
from needle_sim_ros.ros.soak.idle import idle_overruns
from needle_sim_ros.ros.soak.load import PRIORITY, load

if TYPE_CHECKING:
    from needle_sim_ros.benchmark.soak import Plan
    from needle_sim_ros.scene import Scene

Figures = dict[str, float | None]
_IDLE = 10.0  # s of the machine alone


@contextmanager
def _unwinding() -> Iterator[None]:
    """End as Ctrl-C does when told to by a signal: no node or peer stays behind."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {each: signal.signal(each, interrupt) for each in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def drive(scene: Scene, plan: Plan, advance: Callable[[float], object]) -> Figures:
    """Soak the node.

    Parameters
    ----------
    scene : Scene
        What it simulates.
    plan : Plan
        How long and how often.
    advance : callable
        Told of the share of the work done since the last call.

    Raises
    ------
    NeedleSimError
        When the plan's processor cannot be had, or the node ends.
    """
    core = plan.dedicated_core
    reason = why_not(core) if core != -1 else ""
    if reason:
        raise NeedleSimError(f"dedicated_core = {core}: {reason}")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with _unwinding(), tempfile.TemporaryDirectory(prefix="needle_sim_soak_") as folder:
        place = Path(folder)
        os.environ.setdefault("ROS_LOG_DIR", str(place / "log"))
        (place / "scene.yaml").write_text(scene.to_yaml(), encoding="utf-8")
        parameters: dict[str, object] = {"scene": str(place / "scene.yaml"), "rate": plan.rate}
        domain = free_domain()
        total = plan.seconds
        loaded = load(
            {**parameters, "dedicated_core": core, "keep_awake": plan.keep_awake},
            domain,
            place,
            plan.steady,
            plan.crowd,
            plan.cycles,
            lambda seconds: advance(seconds / total),
        )
        idle = idle_overruns(plan.rate, loaded.tick_p50, min(_IDLE, plan.steady), PRIORITY)
        share = plan.hostile_seconds / total / plan.hostile
        hostility = provoke(
            scene,
            parameters,
            domain,
            place / "hostile.log",
            plan.hostile,
            lambda number: advance(number * share),
        )
        endings = end_nodes(
            parameters, domain, place, plan.endings, lambda: advance(plan.ending_seconds / total)
        )
    latencies = np.array(loaded.latencies) * plan.rate
    measured = len(latencies) > 0
    return {
        "ticks": loaded.ticks,
        "overrun_fraction": loaded.overruns / max(1, loaded.ticks + loaded.overruns),
        "idle_loop_overrun_fraction": idle,
        "stolen_by_host_fraction": loaded.undisturbed.stolen,
        "undisturbed_seconds": loaded.undisturbed.seconds,
        "undisturbed_overrun_fraction": loaded.undisturbed.overruns,
        "lost_messages": loaded.lost,
        "missing_ticks_recorded": loaded.gaps,
        "rss_growth_mb": loaded.rss_growth,
        "rss_growth_after_stroke_mb": loaded.rss_growth_after_stroke,
        "open_files_growth": loaded.files_growth,
        "tick_p50_ms": 1e3 * loaded.tick_p50,
        "tick_p99_ms": 1e3 * loaded.tick_p99,
        "lateness_p99_ms": 1e3 * loaded.lateness_p99,
        "realtime_priority": float(loaded.realtime),
        "dedicated_core": float(core),
        "keep_awake": float(plan.keep_awake),
        "latency_median_ticks": float(np.median(latencies)) if measured else None,
        "latency_p99_ticks": float(np.percentile(latencies, 99)) if measured else None,
        "latency_samples": len(latencies),
        "crowd_ticks": loaded.crowd_ticks,
        "crowd_overrun_fraction": loaded.crowd_overruns
        / max(1, loaded.crowd_ticks + loaded.crowd_overruns),
        "recordings_started": loaded.cycles,
        "hostile_messages": hostility.messages,
        "hostile_steps": hostility.steps,
        "state_changes_by_hostile_messages": hostility.changed,
        "kill9_count": len(endings.losses),
        "kill9_worst_loss_s": max(endings.losses, default=None),
        "kill9_salvaged": endings.salvaged,
        "sigterm_count": len(endings.durations),
        "sigterm_worst_s": max(endings.durations, default=None),
        "sigterm_clean": endings.clean,
    }
