# SPDX-License-Identifier: Apache-2.0
"""``needle_sim completion``: what a shell needs to complete commands with the Tab key."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

from needle_sim_ros.commands.options import add_json
from needle_sim_ros.commands.output import check_writable, write_json

NAME = "completion"
HELP = "print what a shell needs to complete commands"
DESCRIPTION = """Print a script that lets the Tab key complete commands, options, scenes and files.
Load it now:  source <(needle_sim completion bash)
or always: append that line to ~/.bashrc or ~/.zshrc, with the name of the shell."""
EXAMPLES = ("completion bash", "completion zsh")

# bash completes files by itself (-o default) where this gives nothing
_BASH = """# Tab completion of needle_sim
_needle_sim() {{
    local current="${{COMP_WORDS[COMP_CWORD]}}" words=""
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
    if [ "$COMP_CWORD" -eq 1 ]; then words="{commands}"; fi
    COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _needle_sim needle_sim
"""
# a zsh whose start files load no completion has none that bash's mode could stand on
_ZSH = (
    """(( $+functions[compdef] )) || {{ autoload -Uz compinit && compinit -i; }}
autoload -Uz bashcompinit && bashcompinit
"""
    + _BASH
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("shell", metavar="SHELL", choices=("bash", "zsh"), help="bash or zsh")
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Print the script."""
    check_writable(args.json)
    from needle_sim_ros.commands.parser import build_parser
    from needle_sim_ros.resources import scene_names

    words = completions(build_parser(), scene_names())
    commands = " ".join(sorted([*words, "--help", "--version"]))
    cases = "\n".join(f'        {name}) words="{" ".join(w)}" ;;' for name, w in words.items())
    script = (_BASH if args.shell == "bash" else _ZSH).format(cases=cases, commands=commands)
    print(script, end="")
    write_json(args.json, {"shell": args.shell, "script": script, "words": words})
    return 0


def completions(
    parser: argparse.ArgumentParser, scenes: Sequence[str] = ()
) -> dict[str, list[str]]:
    """Return, by subcommand, the options and fixed words that it takes.

    Parameters
    ----------
    parser : ArgumentParser
        With subcommands.
    scenes : sequence of str
        For the subcommands that take a scene.
    """
    return {
        name: sorted(set(_words(command, scenes))) for name, command in _subcommands(parser).items()
    }


def _words(parser: argparse.ArgumentParser, scenes: Sequence[str]) -> Iterator[str]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            continue
        yield from action.option_strings
        yield from map(str, action.choices or ())
        if action.metavar == "SCENE":
            yield from scenes
    for name, command in _subcommands(parser).items():
        yield name
        yield from _words(command, scenes)


def _subcommands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}
