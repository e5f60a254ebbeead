"""Commands on projects that run foreign code, in processes of their own that are watched."""

import csv
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from kennfeld import cli
from kennfeld.base.errors import Location
from kennfeld.base.machine_code.call_record import ForeignCall, read_calls
from kennfeld.base.machine_code.crash_report import describe_end
from kennfeld.base.process_limits import MOST_PROCESSES
from kennfeld.base.task_runner import WorkersDiedError
from kennfeld.base.watch_folder import FOLDER
from kennfeld.terminal.watched_commands import call_limit
from tests.terminal.foreign_projects import (
    environment,
    run_command,
    write_fmu_project,
    write_python_project,
    write_tank_project,
)

POSIX = pytest.mark.skipif(os.name != "posix", reason="the faults are those of POSIX")
LATE = "if (m->time > 5) "  # neither at the start nor at the points that a check evaluates
HANGING = "for (;;) pause()"
WITH_FORKS = ["-include", "unistd.h", "-include", "sys/mman.h", "-include", "signal.h", "-include", "stdio.h"]
MOST_FORKS = 300  # of all processes together, so that a fault here does not take the machine
FORKING = (
    "static int *forks; if (!forks) forks = mmap(0, 4096, 3, MAP_SHARED | MAP_ANONYMOUS, -1, 0); "
    f"if (__sync_fetch_and_add(forks, 1) < {MOST_FORKS}) fork()"
)
# in a session of its own, without its parent, deaf to SIGTERM
REMAINING = (
    "static int done; if (!done++ && !fork()) { setsid(); signal(SIGTERM, SIG_IGN); signal(SIGHUP, SIG_IGN); "
    'if (!fork()) { FILE *file = fopen("remaining", "w"); fprintf(file, "%d", getpid()); fclose(file); '
    "for (;;) sleep(300); } _exit(0); }"
)
ABORTING_STEP = ["-DIN_STEP=if (t > 4.95) abort()"]
HANGING_STEP = ["-include", "unistd.h", f"-DIN_STEP=if (t > 4.95) {HANGING}"]
CRASHING_END = ["-DNO_RESET", "-DIN_FREE=*(volatile int *)0 = 1"]


def slow(*values: object) -> Any:
    return pytest.param(*values, marks=pytest.mark.slow)


def leftovers(folder: Path) -> list[str]:
    """Return what a command has left in the folders of a project, except for what the user has."""
    names = "kennfeld.toml lag.fmu tank.fmu bench.csv table.py torque.kf __pycache__ temporary home"
    own = set(names.split())
    return [path.name for place in (folder, folder / "temporary") for path in place.iterdir() if path.name not in own]


def shorten_timeout(project: Path) -> None:
    text = project.read_text(encoding="utf-8")
    project.write_text(text.replace("timeout = 5", "timeout = 1"), encoding="utf-8")


@POSIX
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        slow(f"-DIN_GET={LATE}exit(0)", "ended the program with exit status 0 in fmi2GetDerivatives"),
        slow(f"-DIN_GET={LATE}m->k = overflow(0)", "crashed in fmi2GetDerivatives, instance 1, at t = 5.05 s: segment"),
        slow(
            f"-DIN_GET={LATE}kill(getpid(), SIGKILL)", "the system ended the program in fmi2GetDerivatives, instance 1"
        ),
        (f"-DIN_GET={LATE}{HANGING}", "did not return within 1 s in fmi2GetDerivatives, instance 1, at t = 5.05 s"),
        slow("-DIN_INSTANTIATE=*(volatile int *)0 = 1", "crashed in fmi2Instantiate: segmentation fault (SIGSEGV)"),
        slow("-DIN_LOADING=abort()", "crashed while loading its library: aborted (SIGABRT)"),
    ],
)
def test_a_fault_of_an_fmu_is_one_message(tmp_path: Path, fault: str, message: str) -> None:
    project = write_fmu_project(tmp_path, fault)
    if HANGING in fault:
        shorten_timeout(project)
    status, out, err = run_command(project, "simulate", "--quiet")
    assert (status, out) == (2, "")
    [line] = [line for line in err.splitlines() if "runs code of" not in line]
    assert line.startswith("lag.fmu: ")
    assert message in line
    assert leftovers(tmp_path) == []


@POSIX
@pytest.mark.parametrize(
    ("version", "options", "message"),
    [
        slow(2, ABORTING_STEP, "crashed in fmi2DoStep, instance 1, at t = 5.1 s: aborted (SIGABRT)"),
        slow(3, HANGING_STEP, "did not return within 1 s in fmi3DoStep, instance 1, at t = 5.1 s"),
        slow(3, CRASHING_END, "crashed in fmi3FreeInstance, instance 1"),
    ],
)
def test_a_fault_of_co_simulation_is_one_message(
    tmp_path: Path, version: int, options: list[str], message: str
) -> None:
    project = write_tank_project(tmp_path, version, *options)
    if options is HANGING_STEP:
        shorten_timeout(project)
    status, out, err = run_command(project, "simulate", "--quiet")
    assert (status, out) == (2, "")
    [line] = [line for line in err.splitlines() if "runs code of" not in line]
    assert line.startswith(f"tank.fmu: its code {message}")
    assert leftovers(tmp_path) == []


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("command", ["calibrate", slow("report")])
def test_every_command_that_evaluates_is_watched(tmp_path: Path, command: str) -> None:
    status, _, err = run_command(write_fmu_project(tmp_path, f"-DIN_GET={LATE}*(volatile int *)0 = 1"), command)
    assert status == 2
    assert "lag.fmu: its code crashed in fmi2GetDerivatives, instance 1, at t = 5.05 s: segmentation fault" in err
    assert "Traceback" not in err
    assert leftovers(tmp_path) == []


@POSIX
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("os._exit(3)", "table.py: its code ended the program with exit status 3 in table"),
        slow("import time\nwhile True:\n    time.sleep(9)", "table.py: its code did not return within 1 s in table"),
    ],
)
def test_a_fault_of_python_is_one_message(tmp_path: Path, body: str, message: str) -> None:
    project = write_python_project(tmp_path, body)
    if "while" in body:
        shorten_timeout(project)
    status, out, err = run_command(project, "simulate", "--quiet")
    assert (status, out) == (2, "")
    assert message in err.splitlines()[-1]
    assert leftovers(tmp_path) == []


@pytest.mark.slow
@POSIX
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts processes that have ended")
def test_an_fmu_that_forks_in_every_step_does_not_multiply(tmp_path: Path) -> None:
    project = write_fmu_project(tmp_path, *WITH_FORKS, f"-DIN_GET={FORKING}; usleep(10000)")
    status, out, err = run_command(project, "simulate", "--quiet")
    assert (status, out) == (2, "")
    message = rf"lag\.fmu: its code took more than {MOST_PROCESSES} processes, and was ended\. No results were written"
    assert re.match(message, err.splitlines()[-1])
    assert leftovers(tmp_path) == []


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("command", [["simulate"], slow(["calibrate", "--workers", "2"])])
def test_a_process_that_an_fmu_leaves_behind_ends_with_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    project = write_fmu_project(tmp_path, *WITH_FORKS, f"-DIN_GET={REMAINING}")
    text = project.read_text(encoding="utf-8")
    project.write_text(text.replace("max_iterations = 2", "max_iterations = 2\nstarts = 2"), encoding="utf-8")
    status, _, err = run_command(project, *command)
    assert status in (0, 1), err
    number = int((tmp_path / "remaining").read_text())
    for _ in range(1000):  # a busy machine ends a process that was killed a little later
        if state_of_process(number) in ("", "Z"):
            return
        time.sleep(0.02)
    pytest.fail(f"process {number} is left")


def state_of_process(number: int) -> str:
    """Return a letter as `ps` does, empty if there is no such process."""
    line = ["ps", "-o", "stat=", "-p", str(number)]
    return subprocess.run(line, capture_output=True, text=True, check=False).stdout.strip()[:1]


@POSIX
@pytest.mark.slow
def test_python_that_ends_the_program_by_an_exception_fails_at_that_sample(tmp_path: Path) -> None:
    project, target = write_python_project(tmp_path, "if x > 3:\n    raise SystemExit(3)"), tmp_path / "simulation.csv"
    status, _, err = run_command(project, "simulate", "--output", str(target))
    assert (status, "Traceback" in err) == (0, False)
    with target.open(encoding="utf-8", newline="") as file:
        values = [row["y"] for row in csv.DictReader(file)]
    assert values[:7] == ["2", "4", "6", "", "", "", ""]


@POSIX
@pytest.mark.slow
def test_a_crash_after_the_work_is_a_warning(tmp_path: Path) -> None:
    status, out, err = run_command(write_fmu_project(tmp_path, "-DIN_UNLOADING=abort()"), "simulate")
    assert status == 0
    assert "Written to" in out
    assert "warning: lag.fmu: its code crashed when the program ended: aborted (SIGABRT)" in err


@pytest.mark.slow
@POSIX
def test_output_and_exit_status_are_those_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project = write_fmu_project(tmp_path)
    watched = run_command(project, "check")
    assert watched.status == cli.run(["check", "--trust", str(project)]) == 0
    assert watched.out == capsys.readouterr().out
    assert leftovers(tmp_path) == []


@POSIX
@pytest.mark.slow
@pytest.mark.parametrize("whole_group", [True, False])
def test_ctrl_c_writes_the_best_values_so_far(tmp_path: Path, whole_group: bool) -> None:
    project = write_fmu_project(tmp_path, "-DIN_GET=if (m->time > 8) usleep(10)")
    running = subprocess.Popen(
        [sys.executable, "-m", "kennfeld", "calibrate", "--trust", str(project)],
        env=environment(tmp_path),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert running.stderr is not None
    while "iteration" not in running.stderr.readline():
        assert running.poll() is None
    if whole_group:
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does
    else:
        running.send_signal(signal.SIGTERM)
    out, err = running.communicate(timeout=120)
    assert running.returncode == 130
    assert "stopped: " in out
    assert "Traceback" not in err
    assert leftovers(tmp_path) == ["results"]


@POSIX
@pytest.mark.slow
@pytest.mark.parametrize("closes", [True, False])
def test_a_terminal_is_that_of_the_command(tmp_path: Path, closes: bool) -> None:
    project = write_fmu_project(tmp_path, "-DIN_GET=if (m->time > 8) usleep(10)")
    terminal, other_end = os.openpty()
    code = (
        "import os, sys\n"
        "terminal = os.open(os.ttyname(0), os.O_RDWR)\n"  # the first that a session opens becomes its own
        "for number in range(3): os.dup2(terminal, number)\n"
        "os.close(terminal)\nos.execv(sys.argv[1], sys.argv[1:])"
    )
    line = [sys.executable, "-c", code, sys.executable, "-m", "kennfeld", "calibrate", "--trust", str(project)]
    running = subprocess.Popen(line, stdin=other_end, env=environment(tmp_path), start_new_session=True)
    os.close(other_end)
    shown = b""
    while b"iteration" not in shown:
        shown += os.read(terminal, 1000)
    if closes:
        os.close(terminal)
    else:
        os.write(terminal, b"\x03")  # Ctrl-C
        shown += read_all(terminal)
        assert shown.count(b"Stopping at the best values so far") == 1
        assert b"stopped: " in shown
    assert running.wait(timeout=120) == 130
    assert leftovers(tmp_path) == ["results"]


def read_all(terminal: int) -> bytes:
    """Return what a terminal shows until its last process has ended."""
    shown = b""
    with suppress(OSError):
        while part := os.read(terminal, 1000):
            shown += part
    os.close(terminal)
    return shown


def wait_for_lasting_call(folder: Path) -> None:
    """Wait until the same call runs at two looks."""
    calls: tuple[ForeignCall, ...] = ()
    while True:
        before, calls = calls, tuple(call for each in folder.glob("*/") for call in read_calls(each))
        if calls and calls == before:
            return
        time.sleep(0.3)


@POSIX
@pytest.mark.slow
def test_a_second_request_ends_a_call_that_does_not_return(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = write_fmu_project(tmp_path, f"-DIN_GET={LATE}{HANGING}")
    project.write_text(project.read_text().replace("timeout = 5", "timeout = 1000"))
    code = "from kennfeld.terminal import watching; watching.PATIENCE = 0.1; from kennfeld.cli import main; main()"
    running = subprocess.Popen(
        [sys.executable, "-c", code, "simulate", "--trust", str(project)],
        env=environment(tmp_path),
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for_lasting_call(tmp_path / "temporary")
    running.send_signal(signal.SIGTERM)
    time.sleep(0.1)
    running.send_signal(signal.SIGTERM)
    _, err = running.communicate(timeout=120)
    assert (running.returncode, "Traceback" in err) == (130, False)
    assert leftovers(tmp_path) == []


@POSIX
@pytest.mark.slow
def test_a_process_does_not_outlive_the_one_that_watches_it(tmp_path: Path) -> None:
    project = write_fmu_project(tmp_path, f"-DIN_GET={LATE}sleep(1000)")
    line = [sys.executable, "-m", "kennfeld", "simulate", "--trust", str(project)]
    running = subprocess.Popen(line, env=environment(tmp_path), stderr=subprocess.DEVNULL)
    while not (numbers := list((tmp_path / "temporary").glob("*/process"))) or not numbers[0].read_text():
        time.sleep(0.05)
    process = int(numbers[0].read_text())
    running.kill()
    running.wait()
    while Path(f"/proc/{process}").exists():
        time.sleep(0.05)
    end = time.monotonic() + 30
    while leftovers(tmp_path) and time.monotonic() < end:  # the process that watches removes the folder after it
        time.sleep(0.05)
    assert leftovers(tmp_path) == []


@POSIX
@pytest.mark.slow
def test_a_worker_that_crashes_costs_its_start_only(tmp_path: Path) -> None:
    project = write_fmu_project(tmp_path, "-DIN_GET=if (m->time > 5 && m->k * m->k > 100) abort()")
    text = project.read_text().replace("max_iterations = 2", "max_iterations = 2\nstarts = 4")
    text = text.replace('["tau", "k"]', '["k"]')
    project.write_text(f"{text}[parameters.k]\nbounds = [-50, 50]\n")
    status, out, _ = run_command(project, "calibrate", "--workers", "2")
    assert status in (0, 1)
    assert "3 of them failed, one with the message: The worker process of this start ended: lag.fmu: its code" in out
    assert "crashed in fmi2GetDerivatives, instance 1, at t = " in out
    assert leftovers(tmp_path) == ["results"]


@POSIX
def test_a_worker_that_ended_in_a_call_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise WorkersDiedError.of(Location("cluster"), "all workers have ended", "Start others.")

    monkeypatch.setenv(FOLDER, str(tmp_path))
    monkeypatch.setattr("kennfeld.project.Project.read", fail)
    record = "from kennfeld.base.machine_code.call_record import CallRecord as C; C('lag.fmu', ['fmi2DoStep']).begin(1)"
    worker = subprocess.Popen([sys.executable, "-c", f"{record}; import os; os.abort()"])
    status = worker.wait()
    assert describe_end(worker.pid, status) == "lag.fmu: its code crashed in fmi2DoStep: aborted (SIGABRT)"
    assert cli.run(["check", "--trust", str(write_python_project(tmp_path, "pass"))]) == 2
    assert capsys.readouterr().err.startswith("lag.fmu: a process ended while its code ran in fmi2DoStep. No results")


@POSIX
@pytest.mark.slow
def test_workers_of_a_cluster_that_crash_are_one_message(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    in_worker = (
        'char name[400]; int main = 0; snprintf(name, 400, "%s/process", getenv("KENNFELD_WATCH"));'
        'FILE *file = fopen(name, "r"); fscanf(file, "%d", &main); fclose(file); if (main != getpid()) abort();'
    )
    project = write_fmu_project(tmp_path, f"-DIN_GET={LATE}{{ {in_worker} }}")
    project.write_text(f"{project.read_text()}[cluster]\nworkers = 2\npartition = 50\n")
    status, _, err = run_command(project, "calibrate")
    assert status == 2
    assert "Traceback" not in err
    assert "lag.fmu: a process ended while its code ran in fmi2GetDerivatives, instance 1, at t = 5.05 s" in err


@pytest.mark.parametrize(
    ("arguments", "limit"),
    [
        (["calibrate", "kennfeld.toml"], 2.0),
        (["calibrate", "-q", "kennfeld.toml", "--workers", "2"], 2.0),
        (["check", "kennfeld.toml"], 2.0),
        (["simulate", "kennfeld.toml"], 2.0),
        (["report", "kennfeld.toml"], 2.0),
        (["app", "kennfeld.toml"], 2.0),
        (["app"], 60.0),
        (["check", "--no-run", "kennfeld.toml"], None),
        (["check", "--help"], None),
        (["info", "lag.fmu"], None),
        (["check", "missing.toml"], None),
        (["check", "plain.toml"], None),
        ([], None),
    ],
)
def test_commands_that_evaluate_foreign_code_have_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], limit: float | None
) -> None:
    (tmp_path / "kennfeld.toml").write_text('[model]\nfile = "lag.fmu"\ntimeout = 2\n')
    (tmp_path / "plain.toml").write_text('[model]\nfile = "torque.kf"\n[functions]\nf = "lag.c:lag"\n')
    monkeypatch.chdir(tmp_path)
    assert call_limit(arguments) == limit
