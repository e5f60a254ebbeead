"""A Dask cluster of real processes that a test may kill, and short calibrations on it."""

import multiprocessing
import os
import socket
from importlib import import_module
from itertools import count
from pathlib import Path

import numpy as np

from tests.project.partitioned_projects import FEW, STEADY, TIMED, write_steady, write_timed

SHORT = '\n[optimizer]\ncontinuation = "off"\nmax_iterations = 3\n'
SIZE = 200  # samples of a partition: every recording of a short project is cut
PATIENCE = 120  # s, for processes to start on a busy machine
QUIET = {  # what Dask measures many times a second
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
IMPORTED = [
    "distributed.cli.dask_scheduler",
    "distributed.cli.dask_worker",
    "kennfeld.base.dask_runner",
    "kennfeld.project.partitioned_loading",
    "kennfeld.optimize.sums.partitioned_sums",
]


# breakpoints that are not searched in the data
FIXED = STEADY.replace("count = 6", "begin = 800, end = 4800, count = 3")
FIXED = FIXED.replace("count = 5", "begin = 10, end = 100, count = 2")
FIXED = FIXED.replace(
    '"zw", count = 4', '"zw", begin = 0, end = 12, count = 3'
)  # breakpoints are not searched in the data


def write_short(folder):
    return write_steady(folder, files=2, samples=250, text=FIXED + SHORT)


def write_short_with_quantiles(folder):
    return write_steady(folder, files=2, samples=250, text=FEW + SHORT)


def write_short_drives(folder):
    return write_timed(folder, files=3, samples=150, text=TIMED + SHORT)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def start_method():
    """Return how processes are started: forked from one that has imported Dask, if the system can do that."""
    return "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


def process_context():
    context = multiprocessing.get_context(start_method())
    context.set_forkserver_preload(IMPORTED)
    return context


def run_dask_command(module, arguments, folder, log):
    """Run a command of Dask in this process, as its script does."""
    os.chdir(folder)
    with Path(log).open("wb") as file:
        for descriptor in (1, 2):
            os.dup2(file.fileno(), descriptor)
    command = import_module(f"distributed.cli.{module}").main
    with import_module("dask").config.set(QUIET):
        command(arguments)


class Cluster:
    """A scheduler and workers, each a process of its own that a test may kill; `options` are those of all."""

    def __init__(self, folder, workers, protocol="tcp", options=()):
        self.folder, self.address = Path(folder), f"{protocol}://127.0.0.1:{free_port()}"
        self.options, self._numbers, self._context = options, count(), process_context()
        self.scheduler = self._start("dask_scheduler", "--host", self.address, "--no-dashboard")
        self.workers = [self.add_worker(f"worker-{number}") for number in range(workers)]

    def add_worker(self, name):
        options = ("--nthreads", "1", "--no-nanny", "--name", name, "--no-dashboard", "--memory-limit", "0")
        return self._start("dask_worker", self.address, *options)

    def _start(self, module, *arguments):
        log = self.folder / f"{module}-{next(self._numbers)}.log"
        target = (module, [*arguments, *self.options], str(self.folder), str(log))
        process = self._context.Process(target=run_dask_command, args=target, daemon=True)
        process.start()
        return process

    def wait_for_workers(self, **connection):
        """Wait until the scheduler answers and all workers have joined."""
        client_class = import_module("distributed").Client
        with client_class(self.address, timeout=PATIENCE, set_as_default=False, **connection) as client:
            if self.workers:
                client.wait_for_workers(len(self.workers), timeout=PATIENCE)

    def kill_worker(self, number):
        self.workers[number].kill()
        self.workers[number].join()

    def close(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.join()


def values_of(result):
    return np.concatenate([np.ravel(result.parameters[name].values) for name in result.parameters])


def calibrate(project, progress=None):
    try:
        result = project.calibrate(progress)
        assert result.trust  # computed while the cluster is there
        return result
    finally:
        project.close()
