"""Completion of the command line, by the function that each shell calls."""

import os
import shlex
import shutil
import subprocess
import sys

import pytest

from kennfeld import cli
from kennfeld.terminal.shell_completion import COMPLETE, SHELLS

COMMANDS = {"cache", "calibrate", "check", "completion", "convert"}  # those that begin with c
ZSH = """
compdef() {{ }}
compadd() {{ while [[ $1 != -a ]] {{ shift }}; print -l -- ${{(P)2}} }}
_describe() {{ print -l -- ${{${{(P)3}}%%:*}} }}
_path_files() {{ print -l -- $PREFIX*(N) }}
eval "$(kennfeld completion zsh)"
words=({words}) CURRENT={number}
_kennfeld_completion || true
"""
BASH = """
eval "$(kennfeld completion bash)"
COMP_WORDS=({words}) COMP_CWORD={last}
compopt() {{ compgen -f -- "${{COMP_WORDS[COMP_CWORD]}}"; }}
_kennfeld_completion kennfeld
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
FISH = """
kennfeld completion fish | source
complete --do-complete "{line}"
"""
POWERSHELL = """
kennfeld completion powershell | Out-String | Invoke-Expression
(TabExpansion2 -inputScript "{line}" -cursorColumn {length}).CompletionMatches | ForEach-Object {{ $_.CompletionText }}
"""
SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH, "powershell": POWERSHELL}
PROGRAMS = {"powershell": "pwsh"}


@pytest.fixture
def run_shell(tmp_path, monkeypatch):
    """A function that returns what a shell completes a line to, in a folder with a project file."""
    program = tmp_path / "bin" / "kennfeld"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m kennfeld "$@"\n')
    program.chmod(0o755)
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "kennfeld.toml").touch()
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("HOME", str(tmp_path))

    def run(shell, line):
        words = shlex.split(line) + [""] * line.endswith(" ")
        script = SCRIPTS[shell].format(
            line=line, length=len(line), words=shlex.join(words), number=len(words), last=len(words) - 1
        )
        options = ["-NoProfile", "-Command"] if shell == "powershell" else ["-c"]
        command = [PROGRAMS.get(shell, shell), *options, script]
        # without the terminal of the tests, whose foreground a shell may take
        own = {"stdin": subprocess.DEVNULL, "start_new_session": True}
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=True, **own)
        assert done.stderr == ""
        return {text.split("\t")[0].removeprefix("./") for text in done.stdout.splitlines()}

    return run


@pytest.fixture(params=SHELLS)
def shell(request):
    if shutil.which(PROGRAMS.get(request.param, request.param)) is None:
        pytest.skip(f"{request.param} is not installed")
    return request.param


def test_a_shell_completes_commands(shell, run_shell):
    assert run_shell(shell, "kennfeld c") == COMMANDS


def test_a_shell_completes_options(shell, run_shell):
    assert run_shell(shell, "kennfeld calibrate kennfeld.toml --re") == {"--resume"}


def test_a_shell_completes_names_after_a_blank(shell, run_shell):
    assert run_shell(shell, "kennfeld demo ") == {"torque", "exhaust", "idle"}


def test_a_shell_completes_files(shell, run_shell):
    assert "kennfeld.toml" in run_shell(shell, "kennfeld check kenn")


def ask_powershell(monkeypatch, capsys, words, incomplete):
    """What the completer of PowerShell is given for a line, by the program that it runs."""
    monkeypatch.setattr(sys, "argv", ["kennfeld"])
    monkeypatch.setenv(COMPLETE, "powershell_complete")
    monkeypatch.setenv("COMP_WORDS", "\n".join(words))
    monkeypatch.setenv("COMP_INCOMPLETE", incomplete)
    with pytest.raises(SystemExit, match="0"):
        cli.main()
    return [line.split("\t") for line in capsys.readouterr().out.splitlines()]


def test_powershell_completes_commands_with_their_help(monkeypatch, capsys):
    rows = ask_powershell(monkeypatch, capsys, ["kennfeld"], "c")
    assert {value for _, value, _ in rows} == COMMANDS
    assert all(kind == "plain" and text for kind, _, text in rows)


def test_powershell_completes_options_and_kinds_of_files(monkeypatch, capsys):
    assert ask_powershell(monkeypatch, capsys, ["kennfeld", "check"], "--no")[0][:2] == ["plain", "--no-run"]
    assert ask_powershell(monkeypatch, capsys, ["kennfeld", "check"], "a b") == [["file", "a b", ""]]


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_names_program_and_variable(shell, capsys):
    assert cli.run(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert f"{COMPLETE}={shell}_complete" in script.replace('"', "").replace(" = ", "=")
    assert "kennfeld" in script
    assert "%(" not in script


def test_an_unknown_shell_is_refused(capsys):
    assert cli.run(["completion", "tcsh"]) == 2
    assert "'bash', 'zsh', 'fish', 'powershell'" in capsys.readouterr().err
