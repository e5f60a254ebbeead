"""Starts as tasks of a cluster."""

import pickle
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from kennfeld.base.arrays import ignore_floating_errors
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.base.task_runner import TaskRunner, message_line
from kennfeld.optimize.fit.result import Checkpoint, CheckpointSink, Progress, TraceLine
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.start_runner import StartOutcome, StartPoint, StartRunner
from kennfeld.optimize.solver.levenberg_marquardt import Stop


def run_on_cluster(
    runner: TaskRunner,
    problem: Problem,
    options: Options,
    points: Sequence[StartPoint],
    progress: Progress,
    keep: CheckpointSink,
) -> list[StartOutcome]:
    """Run starts as tasks of a cluster; see `run_in_parallel`.

    `progress` and `keep` are called in this thread; `Stop` in them ends all starts at their best values.
    """

    def receive(message: bytes) -> bool:
        content: TraceLine | Checkpoint = pickle.loads(message)
        try:
            if isinstance(content, TraceLine):
                progress(content)
            else:
                keep(content)
        except Stop:
            return True
        return False

    shared = pickle_content((replace(problem), replace(options, cluster=None)))  # a copy has no cached properties
    return list(runner.map_with_messages(run_start, shared, [pickle_content(point) for point in points], receive))


def run_start(shared: bytes, item: bytes, arguments: bytes) -> StartOutcome:
    """Run one start on a worker."""
    line, point = message_line(), pickle.loads(item)

    def report(entry: TraceLine) -> None:
        line.send(pickle_content(entry))
        if line.is_stopping():
            raise Stop

    if line.is_stopping():
        outcome: StartOutcome = point.skip()
        return outcome
    # workers do not inherit the settings of the client
    with ignore_floating_errors():
        return _start_runner(shared).run_start(point, report, lambda saved: line.send(pickle_content(saved)))


@lru_cache(maxsize=1)
def _start_runner(shared: bytes) -> StartRunner:
    """Return the runner of a problem, which compiles it once in each process."""
    return StartRunner(*pickle.loads(shared))
