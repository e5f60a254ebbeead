"""Jobs of Windows, with the functions of its kernel replaced: what they are asked for."""

import ctypes

import pytest

from kennfeld.base import windows_job
from kennfeld.base.windows_job import WindowsJob, _ExtendedLimits

HANDLE = 1 << 40  # wider than an `int` of C


class Kernel:
    """Stands for kernel32: it keeps the calls, and the limits of the only job."""

    def __init__(self, peak=0):
        self.calls, self.limits, self.peak = [], _ExtendedLimits(), peak
        self.CreateJobObjectW = self._function("CreateJobObjectW", lambda *_: HANDLE)
        self.OpenProcess = self._function("OpenProcess", lambda *_: HANDLE + 1)
        self.SetInformationJobObject = self._function("SetInformationJobObject", self._set)
        self.QueryInformationJobObject = self._function("QueryInformationJobObject", self._query)
        self.AssignProcessToJobObject = self._function("AssignProcessToJobObject", lambda *_: 1)
        self.CloseHandle = self._function("CloseHandle", lambda *_: 1)

    def _function(self, name, work):
        def call(*arguments):
            self.calls.append((name, [getattr(argument, "value", argument) for argument in arguments]))
            return work(*arguments)

        return call

    def _set(self, job, kind, limits, size):
        ctypes.memmove(ctypes.byref(self.limits), limits, size)
        return 1

    def _query(self, job, kind, limits, size, written):
        self.limits.PeakJobMemoryUsed = self.peak
        ctypes.memmove(limits, ctypes.byref(self.limits), size)
        return 1


@pytest.fixture
def kernel(monkeypatch):
    kernel = Kernel(peak=3 << 30)
    monkeypatch.setattr(windows_job, "_kernel", lambda: kernel)
    return kernel


def test_the_limits_have_the_size_and_the_flags_that_windows_documents(kernel):
    job = WindowsJob(processes=5, memory=6 << 30)
    basic = kernel.limits.BasicLimitInformation
    assert ctypes.sizeof(_ExtendedLimits) == (144 if ctypes.sizeof(ctypes.c_void_p) == 8 else 112)
    # JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE, _JOB_MEMORY and _ACTIVE_PROCESS
    assert basic.LimitFlags == 0x2000 | 0x200 | 0x8
    assert (basic.ActiveProcessLimit, kernel.limits.JobMemoryLimit) == (5, 6 << 30)
    job.set_limits()
    assert basic.LimitFlags == 0x2000
    assert job.most_memory() == 3 << 30


def test_a_process_is_put_into_the_job_and_its_handle_closed(kernel):
    job = WindowsJob()
    job.add(77)
    job.close()
    job.close()
    assert kernel.calls[-4:] == [
        ("OpenProcess", [0x101, False, 77]),
        ("AssignProcessToJobObject", [HANDLE, HANDLE + 1]),
        ("CloseHandle", [HANDLE + 1]),
        ("CloseHandle", [HANDLE]),
    ]


def test_elsewhere_a_job_does_nothing(monkeypatch):
    monkeypatch.setattr(windows_job, "_kernel", lambda: None)
    job = WindowsJob(5, 6)
    job.add(1)
    job.set_limits(memory=1)
    job.close()
    assert job.most_memory() == 0
