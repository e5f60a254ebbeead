"""Libraries that damaged files crash run in another process, with memory in proportion to the file."""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base import library_process
from kennfeld.base.errors import InputError
from kennfeld.base.library_process import LibraryProcess
from kennfeld.base.process_limits import memory_bound
from kennfeld.measurement.source import MeasurementFile, locate

POSIX = pytest.mark.skipif(os.name != "posix", reason="the faults are those of POSIX")


@pytest.fixture
def process():
    process = LibraryProcess("MDF")
    yield process
    process._end()


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("time,Speed\n0,1\n1,2\n", encoding="utf-8")
    return locate(path)


# work for the other process
def double(source: MeasurementFile, values: np.ndarray) -> np.ndarray:
    print("a library prints")
    print("and complains", file=sys.stderr)
    return 2 * values


def crash(source: MeasurementFile) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def take(source: MeasurementFile, size: int) -> int:
    return len(np.ones(size, dtype=np.uint8))


def search(source: MeasurementFile) -> None:
    while True:
        pass


def search_once(source: MeasurementFile, trace: Path) -> None:
    """Exhaust the time at once, and leave a trace of having been called."""
    with trace.open("a", encoding="utf-8") as stream:
        stream.write("read\n")
    os.kill(os.getpid(), signal.SIGXCPU)


def refuse(source: MeasurementFile) -> None:
    raise InputError.of(source.location, "holds nothing", "Look for another.")


def name_folder(source: MeasurementFile) -> str:
    return str(Path.cwd())


def test_arrays_are_returned_and_printed_text_is_not(process, source, capfd):
    values = np.arange(6.0).reshape(2, 3)
    doubled = process.call(double, source, values)
    assert doubled.tolist() == (2 * values).tolist()
    doubled[0, 0] = 7.0  # as after reading in this process
    assert process.is_running
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@POSIX
def test_a_crash_is_one_message_and_the_next_file_is_read(process, source):
    message = r"^drive\.csv: the MDF file is damaged: the library that reads it crashed \(SIGSEGV\)\. Copy or export"
    with pytest.raises(InputError, match=message):
        process.call(crash, source)
    assert process.call(double, source, np.ones(2)).tolist() == [2.0, 2.0]


@POSIX
@pytest.mark.slow
def test_a_library_that_does_not_come_to_an_end_is_ended(process, source, monkeypatch):
    monkeypatch.setattr(library_process, "_TIME", 1.0)
    with pytest.raises(InputError, match=r"damaged: the library that reads it does not come to an end\. Copy"):
        process.call(search, source)


@POSIX
def test_a_file_whose_reading_does_not_end_is_read_once(process, source, tmp_path):
    trace = tmp_path / "trace.txt"
    message = r"does not come to an end"
    for _ in range(3):
        with pytest.raises(InputError, match=message):
            process.call(search_once, source, trace)
    other = tmp_path / "another.csv"
    other.write_bytes(source.path.read_bytes())
    with pytest.raises(InputError, match=message):
        process.call(search_once, locate(other), trace)
    assert trace.read_text("utf-8") == "read\n"
    other.write_bytes(source.path.read_bytes().replace(b"2", b"3"))
    assert process.call(double, locate(other), np.ones(1)).tolist() == [2.0]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the memory of a process exactly")
def test_memory_beyond_what_the_file_can_need_is_refused(process, source):
    bound = memory_bound(source.size)
    message = r"damaged: reading its 1\.9e-05 MB takes more than 403 MB of memory"
    with pytest.raises(InputError, match=message):
        process.call(take, source, 2 * bound)
    assert process.call(take, source, 1000) == 1000


def test_errors_come_back_with_their_findings(process, source):
    with pytest.raises(InputError) as caught:
        process.call(refuse, source)
    assert [finding.remedy for finding in caught.value.findings] == ["Look for another."]


def test_relative_paths_are_those_of_the_present_folder(process, source, tmp_path, monkeypatch):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        assert Path(process.call(name_folder, source)).name == folder
