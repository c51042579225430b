# SPDX-License-Identifier: Apache-2.0
"""Replay of an experiment that others recorded: simulated from mapped topics, then compared."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from needle_sim_ros.commands.options import load_scene, parse_overrides
from needle_sim_ros.commands.output import prepared, progress, table, write_json
from needle_sim_ros.errors import SessionError

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene
    from needle_sim_ros.session.experiment import Experiment


def replay_measured(args: argparse.Namespace) -> int:
    """Simulate, compare, write what was asked for, and give the verdict."""
    from needle_sim_ros.session.agreement import agreement
    from needle_sim_ros.session.compare import beyond, read_tolerances
    from needle_sim_ros.session.foreign import bag_contents, read_experiment
    from needle_sim_ros.session.mapping import read_mapping
    from needle_sim_ros.session.replay import replay

    tolerances = read_tolerances(args.tolerance)
    given = None if args.scene is None else load_scene(args.scene, args.overrides)
    mapping = read_mapping(args.mapping, args.topics)
    begin = time.perf_counter()
    experiment = read_experiment(args.bag, mapping, given)
    scene = scene_of(experiment, given, args.overrides)
    preparing = time.perf_counter()
    simulator = prepared(scene)
    preparation = time.perf_counter() - preparing
    with progress(len(experiment), f"replaying {experiment.name}") as bar:
        done = replay(
            experiment.about,
            simulator,
            experiment.ticks(),
            bar.update,
            messages=args.output is not None,
        )
    check_reached(done.series.process, experiment)
    # the series has the bag's clock, the measurements count from the start
    series = replace(done.series, time=experiment.ends[1:])
    differences = agreement(experiment, series)
    took = time.perf_counter() - begin - preparation
    bad = beyond(differences, {"": float("inf"), **tolerances})
    factor = len(experiment) * experiment.tick_period / took
    rows: list[tuple[str, ...]] = [("channel", "greatest difference", "rms", "unit", "")]
    for name, entry in differences.items():
        verdict = "beyond the tolerance" if name in bad else ""
        rows.append((name, f"{entry.max_abs:.3g}", f"{entry.rms:.3g}", entry.unit, verdict))
    title = f"{experiment.name} simulated as {scene.name}"
    print(table(rows, title=title, align="<>><<"))
    for note in experiment.notes:
        print(f"  {note}")
    print(f"  {len(experiment)} ticks in {took:.1f} s: {factor:.1f} x real time")
    if args.output is not None:
        from needle_sim_ros.session.beside import write_beside

        contents = [content for _, content in bag_contents(args.bag)]
        write_beside(args.output, contents, {}, done, scene)
        print(f"bag:  {args.output}")
    if args.plot is not None:
        from needle_sim_ros.view.files import save_figure
        from needle_sim_ros.view.fit import Curves, fit_figure

        save_figure(fit_figure([Curves.of(experiment, simulated=series)], title), args.plot)
        print(f"plot: {args.plot}")
    write_json(
        args.json,
        {
            "bag": str(args.bag),
            "scene": scene.name,
            "ticks": len(experiment),
            "channels": {name: asdict(entry) for name, entry in differences.items()},
            "beyond_tolerance": bad,
            "notes": list(experiment.notes),
            "preparation_time_s": preparation,
            "wall_time_s": took,
            "real_time_factor": factor,
        },
    )
    return 1 if bad else 0


def scene_of(experiment: Experiment, given: Scene | None, pairs: list[str]) -> Scene:
    """Return the scene of an experiment; overrides go over the bag's, and are in a given one."""
    scene = experiment.scene(given)
    if given is None and pairs:
        scene = scene.with_changes(parse_overrides(pairs))
    return scene


def check_reached(process: list[str], experiment: Experiment) -> None:
    """Refuse a scene that the commanded motion misses."""
    if set(process) <= {"free"}:
        raise SessionError(
            f"{experiment.name}: the scene does not fit the commands: the needle never reaches"
            " the tissue (base.position, needle.length, or the transform of the command topic)"
        )
