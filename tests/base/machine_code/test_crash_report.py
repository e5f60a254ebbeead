import math
import signal
from enum import IntEnum

import pytest

from kennfeld.base import library_process
from kennfeld.base.machine_code.call_record import ForeignCall
from kennfeld.base.machine_code.crash_report import crash_finding, describe_status, hang_finding, unloading_finding

STEP = ForeignCall("plant.fmu", "fmi2DoStep", 1, 2.5, 7, 4711, ("4711-0.calls", 0))
LOADING = ForeignCall("table.py", "running the file", 0, math.nan, 1, 4711, ("4711-1.calls", 0))


FILES = ["plant.fmu", "table.py"]


def test_a_crash_names_function_instance_and_time() -> None:
    message = "plant.fmu: its code crashed in fmi2DoStep, instance 2, at t = 2.5 s: segmentation fault (SIGSEGV)"
    assert str(crash_finding([STEP], ["plant.fmu"], -11)).startswith(message)


def test_calls_of_several_threads_are_all_named() -> None:
    text = str(crash_finding([STEP, LOADING], FILES, -6))
    assert text.startswith(
        "plant.fmu, table.py: its code crashed in fmi2DoStep, instance 2, at t = 2.5 s, while running"
    )


def test_an_exit_is_not_called_a_crash() -> None:
    assert "its code ended the program with exit status 3 while running the file." in str(
        crash_finding([LOADING], FILES, 3)
    )


@pytest.fixture
def windows(monkeypatch):
    """The signals of Windows, which lack most of those of other systems and count events from 0."""
    names = {"CTRL_C_EVENT": 0, "CTRL_BREAK_EVENT": 1, "SIGINT": 2, "SIGSEGV": 11, "SIGTERM": 15}
    monkeypatch.setattr(signal, "Signals", IntEnum("Signals", names))
    for name in ("SIGKILL", "SIGXCPU"):
        monkeypatch.delattr(signal, name, raising=False)


def test_an_exit_is_not_taken_for_a_signal_that_the_system_lacks(windows) -> None:
    assert "its code ended the program with exit status 0 while running" in str(crash_finding([LOADING], FILES, 0))
    assert describe_status(0) == ""
    assert library_process._reason(0, 1) == "the library that reads it crashed (exit status 0)"


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_process_that_the_system_killed_lacked_memory() -> None:
    assert "probably for lack of memory" in str(crash_finding([STEP], FILES, -9))


def test_a_crash_between_calls_is_suspected_to_come_from_earlier_ones() -> None:
    assert "while no code of the project ran" in str(crash_finding([], ["plant.fmu"], -11))


def test_a_crash_without_foreign_code_does_not_blame_it() -> None:
    assert "before it ran any code of the project: segmentation fault" in str(crash_finding([], [], -11))


def test_a_hang_names_limit_and_key() -> None:
    text = str(hang_finding([STEP], 60.0))
    assert "did not return within 60 s in fmi2DoStep, instance 2, at t = 2.5 s. " in text
    assert "`timeout` under [model]" in text


def test_a_crash_at_the_end_is_a_warning() -> None:
    assert unloading_finding(["plant.fmu"], -6).severity == "warning"


@pytest.mark.parametrize(
    ("status", "text"),
    [(0xC0000005, "access violation"), (0xC0000420, "error 0xC0000420"), (0, ""), (3, ""), (-99, "signal 99")],
)
def test_a_status_has_a_name(status: int, text: str) -> None:
    assert describe_status(status) == text
