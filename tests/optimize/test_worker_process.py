"""A worker process takes with it what foreign code has started in it."""

import os
import queue
import signal
import subprocess

import pytest

from kennfeld.optimize.search.worker_process import WorkerProcess

# leaves the group, the session and the parent, and ignores SIGTERM
COMMAND = """
import os, pickle, signal, sys
sys.path[:] = {path!r}
from kennfeld.optimize.search.worker_process import connect_to_parent
parent = connect_to_parent()
parent.read_work()
reading, writing = os.pipe()
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        os.write(writing, str(os.getpid()).encode())
        signal.pause()
    os._exit(0)
parent.send(int(os.read(reading, 20)))
signal.pause()
"""


class Listening(WorkerProcess):
    def __init__(self):
        self.inbox = queue.SimpleQueue()
        super().__init__(COMMAND, b"N.")

    def handle(self, message):
        self.inbox.put(message)


@pytest.mark.skipif(os.name != "posix", reason="Windows has job objects")
def test_a_worker_that_is_closed_leaves_no_process_behind():
    worker = Listening()
    number = worker.inbox.get(timeout=60)
    os.kill(number, signal.SIGTERM)
    worker.close()
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(number)], capture_output=True, text=True, check=False)
    assert state.stdout.strip()[:1] in ("", "Z")
