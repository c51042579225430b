# SPDX-License-Identifier: Apache-2.0
"""The ``needle_sim`` command: an argparse front over :mod:`needle_sim_ros.commands`.

Exit status: 0 done, 1 the work was done and its verdict is bad (e.g. a comparison
beyond its tolerance), 2 the work could not be done; then one line on stderr says why.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence

from needle_sim_ros.commands.parser import build_parser
from needle_sim_ros.errors import NeedleSimError

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, what shells expect
EXIT_BROKEN_PIPE = 141  # 128 + SIGPIPE


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
