# SPDX-License-Identifier: Apache-2.0
"""The command's manners: errors, help, interruption, start-up."""

import argparse
import os
import signal
import subprocess
import sys
import time

import pytest

from needle_sim_ros.cli import main
from needle_sim_ros.commands import load_all

_COMMAND = [sys.executable, "-m", "needle_sim_ros.cli"]


@pytest.fixture
def files(tmp_path):
    """Return a folder with files that are wrong in several ways."""
    (tmp_path / "broken.yaml").write_text("name: [unclosed\n  tissue: {")
    (tmp_path / "binary.yaml").write_bytes(bytes(range(256)))
    (tmp_path / "empty.yaml").write_text("")
    (tmp_path / "list.yaml").write_text("- 1\n- 2\n")
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "folder").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run missing.yaml", "no such file"),
        ("run gao2017", "did you mean 'gao2016'"),
        ("scene check {0}/broken.yaml", "not valid YAML"),
        ("scene check {0}/binary.yaml", "cannot be read"),
        ("scene check {0}/empty.yaml", "must be a mapping"),
        ("scene check {0}/list.yaml", "must be a mapping"),
        ("scene check {0}/folder", "no such file"),
        ("run gao2016 --set tissue.youngs_modulo=1", "youngs_modulus"),
        ("run gao2016 --set tissue.youngs_modulus=-1", "tissue.youngs_modulus = -1"),
        ("run gao2016 --set tissue.youngs_modulus=nan", "finite"),
        ("run gao2016 --set tissue.poisson_ratio=0.5", "tissue.poisson_ratio"),
        ("run gao2016 --set nonsense", "must be KEY=VALUE"),
        ("run gao2016 --set =1", "must be KEY=VALUE"),
        ("run gao2016 --set tissue.size=[1", "not a YAML value"),
        ("run gao2016 --set protocol=[]", "protocol"),
        ("run gao2016 --json {0}/file/out.json", "{0}/file is not a folder"),
        ("run gao2016 --json {0}/folder", "it is a folder"),
        ("run gao2016 --plot {0}/out.gif", "must end in .png, .svg, .pdf"),
        ("run gao2016 --plot {0}/file/out.png", "cannot write"),
        ("run gao2016 --record {0}/folder", "exists"),
        ("run gao2016 --record {0}/file/bag", "is not a folder"),
        ("plot {0}/missing --output {0}/out.png", "no such session"),
        ("plot {0}/folder --output {0}/out.png", "no MCAP file"),
        ("demo --output {0}/file", "cannot write"),
        ("demo --scene gao2017", "did you mean"),
    ],
)
def test_a_mistake_is_one_line_on_stderr_and_status_2(files, capsys, monkeypatch, line, words):
    monkeypatch.chdir(files)
    assert main(line.format(files).split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert words.format(files) in printed.err
    assert printed.err.count("\n") == 1 and printed.err.startswith("needle_sim: ")


@pytest.mark.parametrize(
    "line",
    ["", "frobnicate", "run", "plot bag", "scene", "scene check", "benchmark frobnicate"],
)
def test_what_the_parser_does_not_know_is_status_2(capsys, line):
    with pytest.raises(SystemExit) as end:
        main(line.split())
    assert end.value.code == 2
    assert "usage: needle_sim" in capsys.readouterr().err


@pytest.mark.parametrize("command", load_all(), ids=lambda command: command.NAME)
def test_help_has_examples_that_parse(capsys, command):
    from needle_sim_ros.cli import build_parser

    with pytest.raises(SystemExit) as end:
        main([command.NAME, "--help"])
    assert end.value.code == 0
    printed = capsys.readouterr().out
    assert len(command.EXAMPLES) >= 2
    for example in command.EXAMPLES:
        assert f"  needle_sim {example}\n" in printed
        build_parser().parse_args(example.split())


def _leaves(parser):
    """Return the parsers without subcommands below a parser, by the words that lead there."""
    below = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not below:
        return {"": parser}
    return {
        f"{name} {words}".strip(): leaf
        for name, inner in below[0].choices.items()
        for words, leaf in _leaves(inner).items()
    }


def test_every_command_gives_json_and_an_example():
    from needle_sim_ros.cli import build_parser

    leaves = _leaves(build_parser())
    assert {"plot", "report", "scene check", "scene keys", "completion"} <= set(leaves)
    for words, parser in leaves.items():
        assert "--json" in parser._option_string_actions, words
        assert "examples:\n  needle_sim " in parser.format_help(), words


def test_starting_loads_nothing_heavy():
    heavy = ["matplotlib", "scipy", "skfem", "rclpy", "mcap", "tqdm"]
    code = (
        "import sys; from needle_sim_ros.cli import build_parser; build_parser();"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr


def test_errors_reach_the_shell_without_a_traceback():
    result = subprocess.run(
        [*_COMMAND, "run", "gao2016", "--set", "needle.radius=0"], capture_output=True, text=True
    )
    assert result.returncode == 2
    assert result.stdout == "" and "Traceback" not in result.stderr
    assert "needle.radius = 0" in result.stderr


@pytest.mark.parametrize("error", [ImportError, ModuleNotFoundError])
def test_a_library_that_cannot_be_loaded_is_one_line(monkeypatch, capsys, error):
    def fail(args):
        raise error("librmw_fastrtps_cpp.so: cannot open shared object file")

    monkeypatch.setattr("needle_sim_ros.commands.plot.execute", fail)
    assert main(["plot", "bag", "--output", "a.png"]) == 2
    printed = capsys.readouterr().err
    assert "librmw_fastrtps_cpp.so" in printed and "install what is missing" in printed
    assert printed.count("\n") == 1


def test_ctrl_c_ends_a_run_quietly(tmp_path):
    options = ["--realtime", "--set", "solver.dynamics=quasi_static"]
    options += ["--set", "solver.track_spacing=4e-3", "--set", "tissue.mesh.spacing_across=2e-3"]
    options += ["--set", "tissue.mesh.spacing_along=4e-3", "--record", f"{tmp_path}/bag"]
    process = subprocess.Popen(
        [*_COMMAND, "run", "gao2016", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # where these tests run in the background, a shell has it ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 60
    while not (tmp_path / "bag").exists() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    tissue, last = err.splitlines()
    assert out == "" and tissue.startswith("tissue: ") and last == "needle_sim: interrupted"
    assert (tmp_path / "bag" / "metadata.yaml").exists()  # what was recorded is kept


def test_a_reader_that_goes_away_is_no_error():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        result = subprocess.run(
            [*_COMMAND, "scene", "check", "gao2016"],
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert result.stderr == ""
    assert result.returncode == 141


def test_text_beyond_the_terminals_encoding_is_no_error():
    result = subprocess.run(
        [*_COMMAND, "scene", "check", "gao2016"],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    assert "120 ? 80 mm" in result.stdout
