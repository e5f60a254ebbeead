"""Processes of a run are found by their mark wherever they went, and end with it."""

import os
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from kennfeld.base.run_processes import MARK, RunProcesses, mark_of, marked_environment, unmarked

POSIX = pytest.mark.skipif(os.name != "posix", reason="Windows has job objects")
pytestmark = POSIX
# leaves its group, its session and its parent, ignores SIGTERM, and listens on a socket
RUNAWAY = """
import os, signal, socket, sys
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        listening = socket.create_server(("127.0.0.1", 0))
        print(os.getpid(), flush=True)
        signal.pause()
    os._exit(0)
os.wait()
"""
ENDED = "import os, time\nfor _ in range(3):\n    if os.fork() == 0: os._exit(0)\nprint(1, flush=True)\ntime.sleep(60)"


@pytest.fixture
def run():
    """Start code in a marked process; the processes are ended after the test."""
    environment = marked_environment()
    processes, started = RunProcesses(mark_of(environment)), []

    def start(code):
        command = [sys.executable, "-S", "-c", code]
        process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        started.append(process)
        return processes, process, int(process.stdout.readline())

    yield start
    processes.end()
    for process in started:
        process.communicate()


def is_running(number):
    with suppress(ProcessLookupError):
        os.kill(number, 0)
        return True
    return False


def test_a_process_outside_its_session_ends_with_the_run(run):
    processes, process, runaway = run(RUNAWAY)
    process.wait()
    assert [each.number for each in processes.find()] == [runaway]
    processes.end()
    assert processes.find() == []
    for _ in range(100):  # until its new parent has taken notice
        if not is_running(runaway) or _is_zombie(runaway):
            return
        time.sleep(0.02)
    pytest.fail("it runs")


def _is_zombie(number):
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(number)], capture_output=True, text=True, check=False)
    return state.stdout.startswith("Z")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts processes that have ended")
def test_forks_that_nobody_waits_for_are_counted(run):
    processes, _, _ = run(ENDED)
    assert processes.surplus() == 3


def test_processes_of_kennfeld_are_not_surplus(run):
    below = {MARK: "above"}
    inner = marked_environment()
    assert inner[MARK].startswith(f"{os.environ.get(MARK, '')}/")
    assert mark_of(below) == "above"
    processes, _, number = run("import os, time\nprint(os.getpid(), flush=True)\ntime.sleep(60)")
    assert ([each.number for each in processes.find()], processes.surplus()) == ([number], 0)
    assert not processes.takes_more_than(1 << 40)


def test_a_program_may_be_allowed_to_outlive_the_run(monkeypatch):
    monkeypatch.setenv(MARK, "above")
    with unmarked():
        assert MARK not in os.environ
    assert os.environ[MARK] == "above"
