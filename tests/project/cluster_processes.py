"""A Dask cluster of real processes that a test may kill, and short calibrations on it."""

import socket
import subprocess
import sys
import time

import numpy as np

from tests.project.partitioned_projects import STEADY, TIMED, write_steady, write_timed

SHORT = '\n[optimizer]\ncontinuation = "off"\nmax_iterations = 12\n'
COMMAND = [sys.executable, "-m", "distributed.cli.{}"]


def write_short(folder):
    return write_steady(folder, files=3, samples=500, text=STEADY + SHORT)


def write_short_drives(folder):
    return write_timed(folder, text=TIMED + SHORT)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Cluster:
    """A scheduler and workers, each a process of its own that a test may kill; `options` are those of all."""

    def __init__(self, folder, workers, protocol="tcp", options=()):
        self.folder, self.address = folder, f"{protocol}://127.0.0.1:{free_port()}"
        self.options = options
        self.scheduler = self._start("dask_scheduler", "--host", self.address, "--no-dashboard")
        self.workers = [self.add_worker(f"worker-{number}") for number in range(workers)]

    def add_worker(self, name):
        options = ("--nthreads", "1", "--no-nanny", "--name", name, "--no-dashboard", "--memory-limit", "0")
        return self._start("dask_worker", self.address, *options)

    def _start(self, module, *arguments):
        command = [part.format(module) for part in COMMAND]
        log = (self.folder / f"{module}-{time.monotonic_ns()}.log").open("wb")
        with log:
            return subprocess.Popen([*command, *arguments, *self.options], stdout=log, stderr=log, cwd=self.folder)

    def kill_worker(self, number):
        self.workers[number].kill()
        self.workers[number].wait()

    def close(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def values_of(result):
    return np.concatenate([np.ravel(result.parameters[name].values) for name in result.parameters])


def calibrate(project, progress=None):
    try:
        result = project.calibrate(progress)
        assert result.trust  # computed while the cluster is there
        return result
    finally:
        project.close()
