# SPDX-License-Identifier: Apache-2.0
"""Completion as the shells themselves do it."""

import os
import pty
import re
import select
import shutil
import signal
import subprocess
import time

import pytest

from needle_sim_ros.cli import main
from needle_sim_ros.commands import load_all


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash here")
    script = tmp_path_factory.mktemp("completion") / "needle_sim.bash"

    def ask(capsys, *words):
        if not script.exists():
            assert main(["completion", "bash"]) == 0
            script.write_text(capsys.readouterr().out)
        line = " ".join(f"'{word}'" for word in words)
        code = f"""source {script}; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}
            _needle_sim; printf '%s\\n' "${{COMPREPLY[@]}}" """
        done = subprocess.run([bash, "-c", code], capture_output=True, text=True, check=True)
        assert done.stderr == ""
        return done.stdout.split()

    return ask


def test_commands_are_completed(complete, capsys):
    found = complete(capsys, "needle_sim", "")
    assert {command.NAME for command in load_all()} <= set(found)
    assert complete(capsys, "needle_sim", "rep") == ["replay", "report"]


def test_options_and_scenes_are_completed(complete, capsys):
    assert complete(capsys, "needle_sim", "plot", "x", "--an") == ["--animate"]
    assert complete(capsys, "needle_sim", "run", "gao2016_") == ["gao2016_steel"]
    assert "check" in complete(capsys, "needle_sim", "scene", "")
    assert complete(capsys, "needle_sim", "benchmark", "scal") == ["scaling"]
    assert complete(capsys, "needle_sim", "plot", "some_file") == []  # the shell's own turn


def test_zsh_gets_the_same_through_its_bash_mode(capsys):
    assert main(["completion", "zsh"]) == 0
    script = capsys.readouterr().out
    assert "autoload -Uz bashcompinit" in script and "complete -o default" in script


@pytest.mark.skipif(shutil.which("zsh") is None, reason="no zsh here")
@pytest.mark.parametrize("start", ["", "autoload -Uz compinit && compinit -u\n"])
def test_zsh_completes_at_the_tab_key(capsys, tmp_path, start):
    assert main(["completion", "zsh"]) == 0
    (tmp_path / ".zshrc").write_text(start + capsys.readouterr().out)
    child, terminal = pty.fork()
    if child == 0:
        os.environ |= {"ZDOTDIR": str(tmp_path), "TERM": "dumb", "PS1": "ready> "}
        os.execvp("zsh", ["zsh", "-i"])
    try:
        assert "command not found" not in _seen_until(terminal, "ready>")
        os.write(terminal, b"needle_sim comple\tzs\t")
        _seen_until(terminal, "needle_simcompletionzsh")
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(terminal)


def _seen_until(terminal, text, patience=20.0):
    """Read a terminal until a text is there, whatever spaces and jumps a redrawn line has."""
    seen, end = "", time.monotonic() + patience
    while text not in re.sub(r"[^\w>]", "", seen):
        assert time.monotonic() < end, seen
        if select.select([terminal], [], [], 0.1)[0]:
            seen += os.read(terminal, 65536).decode(errors="replace")
    return seen
