# SPDX-License-Identifier: Apache-2.0
"""The ``needle_sim`` command: an argparse front over :mod:`needle_sim_ros.commands`.

Exit status: 0 done, 1 the work was done and its verdict is bad (e.g. a comparison
beyond its tolerance), 2 the work could not be done; then one line on stderr says why.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence

from needle_sim_ros import __version__
from needle_sim_ros.commands import Command, load_all
from needle_sim_ros.commands.options import examples
from needle_sim_ros.errors import NeedleSimError

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, what shells expect
EXIT_BROKEN_PIPE = 141  # 128 + SIGPIPE

DESCRIPTION = "Simulate a flexible needle entering soft tissue."


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with every registered subcommand."""
    parser = argparse.ArgumentParser(
        prog="needle_sim",
        description=DESCRIPTION,
        epilog="needle_sim COMMAND --help shows each command's options with examples.",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in load_all():
        _add(subparsers, command)
    return parser


def _add(subparsers: argparse._SubParsersAction[argparse.ArgumentParser], command: Command) -> None:
    parser = subparsers.add_parser(
        command.NAME,
        help=command.HELP,
        description=command.DESCRIPTION,
        epilog=examples(command.EXAMPLES),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.configure(parser)
    parser.set_defaults(execute=command.execute)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return the exit status.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process if not given.
    """
    # the arrays of a tick are small: threads of the linear algebra only make it wait
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # ν and µ on an ASCII terminal
    try:
        args = build_parser().parse_args(argv)
        status = int(args.execute(args))
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader (head, less) went away; keep the interpreter's own flush at exit quiet.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except KeyboardInterrupt:
        print("needle_sim: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except (NeedleSimError, OSError, ImportError) as error:
        print(f"needle_sim: {_one_line(error)}", file=sys.stderr)
        return EXIT_ERROR


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename is not None else ""
        return f"{where}{error.strerror}"
    if isinstance(error, ImportError):
        return f"{error}: install what is missing (see the README)"
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())
