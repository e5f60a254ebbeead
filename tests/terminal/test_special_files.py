"""Names in a project that lead to pipes and devices are refused, where reading them would never end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kennfeld.terminal.special_files import is_special
from tests.project.hostile_projects import PROJECT, write_project

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names are those of POSIX")

COMMAND = [sys.executable, "-m", "kennfeld"]
FILES = {
    "function.kf": PROJECT,
    "start.dcm": PROJECT.replace("[calibration]", '[calibration]\ninitial = "start.dcm"'),
    "helper.py": PROJECT.replace("[[dataset]]", '[functions]\ny = "helper.py"\n[[dataset]]', 1),
}


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return str(tmp_path / "pipe")


def test_pipes_and_devices_are_special_also_behind_links(pipe, tmp_path):
    (tmp_path / "link").symlink_to("/dev/zero")
    assert is_special(pipe)
    assert is_special(str(tmp_path / "link"))
    assert is_special("/dev/zero")


def test_files_and_the_streams_of_the_user_are_not(tmp_path):
    (tmp_path / "bench.csv").write_text("x\n")
    names = [tmp_path / "bench.csv", tmp_path, tmp_path / "missing", "/dev/null", "/dev/stdin", "/dev/fd/0", "a\0b"]
    assert not any(is_special(str(name)) for name in names)


@pytest.mark.parametrize(
    "name", ["function.kf", *(pytest.param(name, marks=pytest.mark.slow) for name in FILES if name != "function.kf")]
)
def test_a_project_with_a_pipe_ends_with_a_message(name, tmp_path):
    path = write_project(tmp_path)
    path.write_text(FILES[name])
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    done = subprocess.run(
        [*COMMAND, "check", "--no-run", Path(path).name],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2
    assert "it is a pipe or a device, not a file" in done.stderr or f"file {name} does not exist" in done.stderr
    assert "Traceback" not in done.stderr
