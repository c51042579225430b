# SPDX-License-Identifier: Apache-2.0
"""Completion as the shells themselves do it."""

import shutil
import subprocess

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
    assert script.startswith("autoload -Uz bashcompinit") and "complete -o default" in script


@pytest.mark.skipif(shutil.which("zsh") is None, reason="no zsh here")
def test_zsh_loads_it(capsys, tmp_path):
    assert main(["completion", "zsh"]) == 0
    script = tmp_path / "needle_sim.zsh"
    script.write_text(capsys.readouterr().out)
    done = subprocess.run(["zsh", "-c", f"source {script}"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""
