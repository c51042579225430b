# SPDX-License-Identifier: Apache-2.0
"""An experiment out of a bag that this package did not record, by mapped topics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.errors import SessionError
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.attached_mesh import attached_mesh, recorded_scene
from needle_sim_ros.session.content import Content, read_content
from needle_sim_ros.session.experiment import Experiment, of_session
from needle_sim_ros.session.imported import imported_mapping, is_imported
from needle_sim_ros.session.mapping import COMMAND, Mapping, TopicMap
from needle_sim_ros.session.measured import commanded, with_measured
from needle_sim_ros.session.reader import mcap_files, session_of
from needle_sim_ros.session.topics import TopicData, read_topic
from needle_sim_ros.session.writer import ABOUT, SCENE_FILE

Times = NDArray[np.int64]
_LEAST_SHARE = 0.5  # of a topic's stamps that have to lie within the command's


def bag_contents(path: str | Path) -> list[tuple[Path, Content]]:
    """Read all MCAP files of a bag; rosbag2 splits long ones.

    Raises
    ------
    SessionError
        When there is none, or one is no MCAP file.
    """
    return [(file, read_content(file)) for file in mcap_files(path)]


def read_experiment(path: str | Path, mapping: Mapping | None, scene: Scene | None) -> Experiment:
    """Read an experiment from a session of this package or from any bag.

    Parameters
    ----------
    path : path
        Folder or MCAP file.
    mapping : Mapping, optional
        Topics of the bag; in a session they replace what they name and the rest stays.
    scene : Scene, optional
        Instead of the one in the bag.

    Raises
    ------
    SessionError
        When the bag is no MCAP file, is empty, has no command topic, or its times go
        backwards.
    """
    files = bag_contents(path)
    contents = [content for _, content in files]
    name = Path(path).name
    if not any(content.messages for content in contents):
        raise SessionError(f"{path}: the bag is empty: it holds no message")
    first_file, first = files[0]
    own = len(files) == 1 and SCENE_FILE in first.attachments and ABOUT in first.metadata
    if is_imported(first):
        kept = imported_mapping(first)
        mapping = kept if mapping is None else kept.with_roles(mapping)
    roles = {} if mapping is None else mapping.roles()
    if own and COMMAND not in roles:
        experiment = of_session(session_of(first_file, first), name)
        data = {role: read_topic(contents, role, topic) for role, topic in roles.items()}
        logged = {role: found.log for role, found in data.items()}
        return with_measured(experiment, data, roles, logged, experiment.begin, scene)
    if mapping is None or COMMAND not in roles:
        there = sorted({c.topic for content in contents for c in content.channels.values()})
        raise SessionError(
            f"{path}: no command topic: it is no session of needle_sim, so say which topic moves"
            f" the base: --topic base_pose:=NAME; its topics: {', '.join(there)}"
        )
    holder = next((c.attachments for c in contents if _has_scene(c)), {})
    text, mesh = holder.get(SCENE_FILE, b"").decode(), attached_mesh(holder)
    if scene is None:
        if not text:
            raise SessionError(f"{path}: the bag holds no scene: give one with --scene")
        scene = recorded_scene(text, mesh)
    data = {role: read_topic(contents, role, topic) for role, topic in roles.items()}
    times, notes = _times(data, roles, mapping.clock)
    begin = int(times[COMMAND][0])
    period = 1.0 / mapping.rate if mapping.rate else scene.solver.time_step
    since = np.asarray((times[COMMAND] - begin) * 1e-9, dtype=float)
    motions, start, more = commanded(data[COMMAND], since, roles[COMMAND], scene, period)
    experiment = Experiment(
        name=name,
        tick_period=period,
        motions=motions,
        measured={},
        scene_text=text,
        mesh=mesh,
        start=start,
        begin=int(data[COMMAND].log[0]),
        notes=(*notes, *more),
    )
    return with_measured(experiment, data, roles, times, begin, scene)


def _has_scene(content: Content) -> bool:
    return SCENE_FILE in content.attachments


def _times(
    data: dict[str, TopicData], roles: dict[str, TopicMap], clock: str
) -> tuple[dict[str, Times], list[str]]:
    """Return the times of all topics by one clock, ns, and what is to be said about it."""
    notes: list[str] = []
    stamped = clock == "header" and all((found.stamps > 0).all() for found in data.values())
    if stamped:
        first, last = data[COMMAND].stamps[0], data[COMMAND].stamps[-1]
        for role, found in data.items():
            inside = (found.stamps >= first) & (found.stamps <= last)
            if inside.mean() < _LEAST_SHARE:
                stamped = False
                notes.append(
                    f"The stamps of {roles[role].topic} are of another clock: log times are used."
                )
    elif clock == "header":
        notes.append("Not all messages are stamped: log times are used.")
    times = {role: found.stamps if stamped else found.log for role, found in data.items()}
    for role, stamps in times.items():
        back = np.flatnonzero(np.diff(stamps) < 0)
        if len(back):
            before, after = stamps[back[0]], stamps[back[0] + 1]
            raise SessionError(
                f"topic {roles[role].topic}: its times go backwards, from"
                f" {before * 1e-9:.3f} to {after * 1e-9:.3f} s at message {back[0] + 2};"
                " `clock: log` in the mapping goes by the recorder's clock instead"
            )
    return times, notes
