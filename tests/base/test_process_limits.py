"""Limits of memory, files and processes that a process sets for itself hold for the code in it."""

import os
import subprocess
import sys

import pytest

from kennfeld.base import process_limits
from kennfeld.base.process_limits import machine_memory

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="other systems have other limits")
SET = """
import ctypes, os, resource, shutil, sys
from collections import namedtuple
from kennfeld.base import process_limits
process_limits.machine_memory = lambda: 1 << 30
shutil.disk_usage = lambda folder: namedtuple("Usage", "free")(8192)
process_limits.limit_foreign_code()
"""
TAKE = """
library = ctypes.CDLL(None)
library.malloc.restype = ctypes.c_void_p
blocks = 0
while library.malloc(ctypes.c_size_t(1 << 26)):
    blocks += 1
print(8 < blocks < 16)
"""
WRITE = """
with open(sys.argv[1], "wb", buffering=0) as file:
    try:
        while file.write(bytes(1024)):
            pass
    except OSError as error:
        print(file.tell(), error.strerror)
"""


def run(code, *arguments):
    command = [sys.executable, "-c", SET + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.strip()


@LINUX
def test_code_that_allocates_without_end_gets_no_more_than_the_machine_has():
    assert run(TAKE) == "True"


@LINUX
def test_a_file_takes_half_of_the_free_space_at_most(tmp_path):
    assert run(WRITE, str(tmp_path / "file")) == "4096 File too large"


@LINUX
def test_processes_and_core_files_are_limited():
    assert run("print(0 < resource.getrlimit(resource.RLIMIT_NPROC)[0] < 100_000)") == "True"
    assert run("print(resource.getrlimit(resource.RLIMIT_CORE)[0])") == "0"


@pytest.mark.skipif(os.name != "posix", reason="read from POSIX")
def test_the_memory_of_the_machine_is_that_of_the_container_if_it_is_smaller(tmp_path, monkeypatch):
    whole = machine_memory()
    assert whole > 1 << 28
    for text, memory in (("max", whole), (str(1 << 27), 1 << 27)):
        (tmp_path / "memory.max").write_text(text)
        monkeypatch.setattr(process_limits, "_CGROUP", (tmp_path / "memory.max",))
        assert machine_memory() == memory or text == "max"
