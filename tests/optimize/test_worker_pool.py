"""A pool goes on without worker processes that end, whatever they were at."""

import numpy as np
import pytest

from kennfeld.optimize.search import worker_pool
from kennfeld.optimize.search.start_runner import StartPoint
from kennfeld.optimize.search.worker_pool import _Pool

VALUES = {"a": np.zeros(1)}


def point(start):
    return StartPoint(start, VALUES, VALUES)


@pytest.fixture
def pool(monkeypatch):
    """Return a function that makes a pool whose workers end at their first, second, ... message if `ends` says so."""

    def make(starts, workers, ends):
        numbers = iter(range(100))

        class Worker:
            def __init__(self, work, inbox):
                self.point, self.ready, self.left, self.inbox = None, False, ends.get(next(numbers), 100), inbox
                self.answer(worker_pool.READY)

            def answer(self, message):
                self.left -= 1
                self.inbox.put((self, message if self.left >= 0 else None))

            def run_start(self, start):
                self.point = start
                self.answer(start.skip("converged"))

            def describe_end(self):
                return "killed (SIGKILL)"

            def close(self):
                pass

        monkeypatch.setattr(worker_pool, "_Worker", Worker)
        return _Pool(
            b"", [point(start) for start in range(1, starts + 1)], workers, lambda line: None, lambda states: None
        )

    return make


@pytest.mark.parametrize("ends", [{0: 1}, {0: 1, 1: 1}, {0: 1, 1: 1, 2: 1, 3: 1}])
def test_starts_whose_workers_end_fail_and_the_others_run(pool, ends):
    outcomes = {outcome.row.start: outcome.row for outcome in pool(8, 4, ends).run()}
    assert sorted(outcomes) == list(range(1, 9))
    failed = [row for row in outcomes.values() if row.status == "failed"]
    assert len(failed) == len(ends)
    assert {row.message for row in failed} == {"The worker process of this start ended: killed (SIGKILL)."}


def test_the_pool_runs_without_workers_that_end_early(pool):
    outcomes = pool(6, 4, {0: 0, 2: 0}).run()
    assert [outcome.row.status for outcome in outcomes] == ["converged"] * 6


def test_no_start_runs_without_a_worker(pool):
    assert pool(6, 2, dict.fromkeys(range(100), 0)).run() == []
