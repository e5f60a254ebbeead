"""Records of calls, written by Python and by machine code, and read by another process."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.machine_code.call_record import (
    CallRecord,
    ForeignCall,
    read_calls,
    recorded_files,
    write_begin,
    write_end,
    write_place,
)
from kennfeld.base.machine_code.engine import compile_functions
from kennfeld.base.machine_code.ir import FunctionWriter
from kennfeld.base.watch_folder import FOLDER

SLOT = ("ptr", "slot")
NAMES = ["fmi2GetReal", "loading its library"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER, str(tmp_path))
    return tmp_path


def test_a_call_is_shown_until_it_returns(folder: Path) -> None:
    record = CallRecord("plant.fmu", NAMES)
    assert read_calls(folder) == ()
    with record.during("loading its library"):
        [call] = read_calls(folder)
        assert (call.file, call.function, call.instance, call.number) == ("plant.fmu", "loading its library", 0, 1)
        assert math.isnan(call.time)
    assert read_calls(folder) == ()
    assert recorded_files(folder) == ("plant.fmu",)


def test_an_exception_ends_a_call(folder: Path) -> None:
    record = CallRecord("table.py", ["table"])
    with pytest.raises(ValueError, match="no"), record.during("table"):
        raise ValueError("no")
    assert read_calls(folder) == ()


def test_threads_have_slots_of_their_own(folder: Path) -> None:
    record = CallRecord("table.py", ["table"], slots=3)
    record.begin(1, slot=2)
    record.begin(1, slot=0)
    record.end(slot=0)
    assert [call.slot[1] for call in read_calls(folder)] == [2]


def test_calls_are_distinguished_by_their_numbers(folder: Path) -> None:
    record = CallRecord("table.py", ["table"])
    numbers = []
    for _ in range(3):
        with record.during("table"):
            numbers += [call.number for call in read_calls(folder)]
    assert numbers == [1, 2, 3]


def test_machine_code_records_function_instance_and_time(folder: Path) -> None:
    record = CallRecord("plant.fmu", NAMES)
    begin, end = FunctionWriter("begin", [SLOT, ("ptr", "time")]), FunctionWriter("end", [SLOT])
    write_place(begin, "%slot", begin.load("%time"), "3")
    write_begin(begin, "%slot", record.number("fmi2GetReal"))
    write_end(end, "%slot")
    compiled = compile_functions(begin, end)
    time = np.array(12.5)
    compiled["begin"](record.address(), time.ctypes.data)
    [call] = read_calls(folder)
    assert isinstance(call, ForeignCall)
    assert (call.function, call.instance, call.time, call.number) == ("fmi2GetReal", 3, 12.5, 1)
    compiled["end"](record.address())
    assert read_calls(folder) == ()


def test_a_record_outlives_its_process(folder: Path) -> None:
    code = (
        "import os; from kennfeld.base.machine_code.call_record import CallRecord\n"
        "record = CallRecord('plant.fmu', ['fmi2GetReal']); record.begin(1); print(os.getpid(), flush=True); os.abort()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    [call] = read_calls(folder)
    assert (call.function, str(call.process)) == ("fmi2GetReal", done.stdout.strip())


def test_nothing_is_shared_if_nobody_watches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(FOLDER, raising=False)
    record = CallRecord("plant.fmu", NAMES)
    with record.during("fmi2GetReal"):
        assert read_calls(tmp_path) == ()


def test_a_missing_folder_is_not_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path / "gone"))
    with CallRecord("plant.fmu", NAMES).during("fmi2GetReal"):
        assert read_calls(tmp_path / "gone") == ()


def test_a_damaged_record_is_ignored(folder: Path) -> None:
    (folder / "1-0.calls").write_bytes(b"no record")
    assert (read_calls(folder), recorded_files(folder)) == ((), ())
