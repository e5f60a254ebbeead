"""Commands on a project that this account may only read: what cannot be written is named, and nothing else happens."""

import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest

from kennfeld import cli
from tests.project.hostile_projects import write_project

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="accounts and permissions are those of POSIX")

NOBODY = 65534
COMMANDS = {
    "check": (["check", "kennfeld.toml"], 0, "kennfeld.toml: no problem found"),
    "info": (["info", "kennfeld.toml"], 0, "kennfeld.toml: project"),
    "calibrate": (["calibrate", "kennfeld.toml"], 2, "results: cannot be written: Permission denied. Name another"),
    "resume": (["calibrate", "kennfeld.toml", "--resume"], 2, "results: cannot be written: Permission denied. Name"),
    "report": (["report", "kennfeld.toml"], 2, "results/report.html: cannot be written: it is write-protected. Name"),
    "simulate": (["simulate", "kennfeld.toml", "-o", "sim.csv"], 2, "sim.csv: cannot be written: Permission denied."),
    "convert": (["convert", "results/parameters.json", "x.dcm"], 2, "x.dcm: cannot be written: Permission denied."),
}


@pytest.fixture(scope="module")
def project():
    """The folder of a calibrated project that nobody may write; `tmp_path` is closed to other accounts."""
    root = Path(tempfile.mkdtemp(prefix="kennfeld-read-only-"))
    root.chmod(0o755)
    folder = write_project(root / "project").parent
    here = Path.cwd()
    try:
        os.chdir(folder)  # which also imports all that the commands need, perhaps from a folder closed to others
        for command in ("info", "calibrate", "report", "simulate", "convert"):
            assert cli.run(COMMANDS[command][0]) in (0, 1)
        for name in ("x.dcm", "sim.csv"):
            (folder / name).unlink()
        shutil.rmtree(folder / ".kennfeld", ignore_errors=True)
        for path in (*folder.rglob("*"), folder):
            path.chmod(0o555 if path.is_dir() else 0o444)
        yield folder
    finally:
        os.chdir(here)
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o755)
        shutil.rmtree(root)


def run_as_nobody(folder, arguments):
    """Run a command in a copy of this process whose account may not write; return its status and what it printed."""
    with tempfile.TemporaryFile() as printed:
        number = os.fork()
        if number == 0:
            status = 99
            try:
                if os.geteuid() == 0:
                    os.setgid(NOBODY)
                    os.setuid(NOBODY)
                os.chdir(folder)
                sys.stdout = sys.stderr = open(printed.fileno(), "w", encoding="utf-8", closefd=False)  # noqa: SIM115
                status = cli.run(arguments)
                sys.stdout.flush()
            finally:
                os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
        printed.seek(0)
        return status, printed.read().decode()


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_names_what_it_cannot_write(project, command):
    arguments, expected, message = COMMANDS[command]
    before = contents(project)
    status, printed = run_as_nobody(project, arguments)
    assert message in printed
    assert "Traceback" not in printed
    assert status == expected
    assert contents(project) == before
