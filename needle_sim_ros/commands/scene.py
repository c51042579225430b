# SPDX-License-Identifier: Apache-2.0
"""``needle_sim scene``: look at a scene without running it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from needle_sim_ros.commands.options import add_json, add_set, examples, load_scene
from needle_sim_ros.commands.output import check_writable, table, write_json

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene

NAME = "scene"
HELP = "check a scene file, list the keys of one"
DESCRIPTION = "Check a scene file and say what it describes, or list the keys that one may have."
EXAMPLES = (
    "scene check gao2016",
    "scene check my_scene.yaml --set tissue.youngs_modulus=30e3",
    "scene check gao2016 --json scene.json",
    "scene keys",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser(
        "check",
        help="read and validate; exit status 2 and the reason if it is not valid",
        description="Read and validate a scene; exit status 2 and the reason if it is not valid.",
        epilog=examples(EXAMPLES),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    check.add_argument("scene", metavar="SCENE", help="a YAML file, or a scene of this package")
    add_set(check)
    add_json(check)
    keys = actions.add_parser(
        "keys",
        help="list every key with its unit, range and default (Markdown)",
        description="List every key of a scene with its unit, range and default, as Markdown.",
        epilog=examples(("scene keys",)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_json(keys)


def execute(args: argparse.Namespace) -> int:
    """Load the scene, which validates it, and describe it; or list the keys."""
    check_writable(args.json)
    if args.action == "keys":
        return _list_keys(args)
    scene = load_scene(args.scene, args.overrides)
    print(table(describe(scene), title=f"{scene.name}: valid"))
    write_json(args.json, {"scene": scene.name, "valid": True, "parameters": scene.to_dict()})
    return 0


def _list_keys(args: argparse.Namespace) -> int:
    from needle_sim_ros.commands.scene_keys import markdown, sections

    print(markdown(), end="")
    found = {
        f"{section.key}.{name}".lstrip("."): {"value": value, "default": default}
        for section in sections()
        for name, value, default in section.rows
    }
    write_json(args.json, {"keys": found})
    return 0


def describe(scene: Scene) -> list[tuple[str, str]]:
    """Return what a scene is, as rows of name and description."""
    tissue, needle, laws, solver = scene.tissue, scene.needle, scene.interaction, scene.solver
    edges = " × ".join(f"{1e3 * edge:g}" for edge in tissue.size)
    plane = f", plane {tissue.plane}, {1e3 * tissue.thickness:g} mm thick"
    return [
        (
            "tissue",
            f"{scene.dimension}D, {edges} mm, E {_pascal(tissue.youngs_modulus)}, "
            f"ν {tissue.poisson_ratio:g}{plane if scene.dimension == 2 else ''}; "
            f"fixed: {', '.join(tissue.fixed or ())}",
        ),
        ("regions", ", ".join(region.name for region in tissue.regions) or "none"),
        (
            "needle",
            f"{1e3 * needle.length:g} mm long, Ø {2e3 * needle.radius:g} mm, "
            f"E {_pascal(needle.youngs_modulus)}, EI {needle.flexural_rigidity:.4g} N m²",
        ),
        (
            "contact",
            f"puncture {laws.puncture.force:g} N, cutting {laws.cutting.force:g} N, friction "
            f"{laws.friction.static:g} N/m static, {laws.friction.kinetic:g} N/m kinetic",
        ),
        ("markers", str(len(scene.markers))),
        (
            "solver",
            f"{solver.dynamics}, time step {1e3 * solver.time_step:g} ms, "
            f"track spacing {1e3 * solver.track_spacing:g} mm",
        ),
        ("protocol", _protocol(scene)),
    ]


def _protocol(scene: Scene) -> str:
    if not scene.protocol:
        return "none"
    duration = sum(segment.duration for segment in scene.protocol)
    speeds = ", ".join(
        f"{segment.duration:.4g} s at {1e3 * sum(v * v for v in segment.velocity) ** 0.5:g} mm/s"
        for segment in scene.protocol[:5]
    )
    more = ", ..." if len(scene.protocol) > 5 else ""
    return f"{duration:.4g} s: {speeds}{more}"


def _pascal(value: float) -> str:
    for factor, unit in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")):
        if value >= factor:
            return f"{value / factor:g} {unit}"
    return f"{value:g} Pa"
