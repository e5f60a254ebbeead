"""Threads of linear algebra in the process of the command, and results that threads share."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from kennfeld.base.threads import computed_once

CODE = """
import os, sys
from kennfeld import cli
cli.run = lambda arguments: print(os.environ["OPENBLAS_THREAD_TIMEOUT"], "numpy" in sys.modules)
cli.main()
"""


@pytest.mark.parametrize(("own", "expected"), [({}, "4"), ({"OPENBLAS_THREAD_TIMEOUT": "20"}, "20")])
def test_threads_are_set_to_sleep_before_numpy_is_loaded(own: dict[str, str], expected: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_THREAD_TIMEOUT"} | own
    assert subprocess.check_output([sys.executable, "-c", CODE], env=environment, text=True).split() == [
        expected,
        "False",
    ]


def test_threads_that_ask_at_the_same_time_get_the_same_object() -> None:
    @computed_once
    def slow(name: str) -> list[str]:
        time.sleep(0.05)
        return [name]

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(slow, ["first"] * 4 + ["second"] * 4))
    assert results == [["first"]] * 4 + [["second"]] * 4
    assert len(set(map(id, results))) == 2


def test_a_result_that_failed_is_computed_again() -> None:
    answers = iter([False, True])

    @computed_once
    def uncertain() -> str:
        if not next(answers):
            raise ValueError("not yet")
        return "result"

    with pytest.raises(ValueError, match="not yet"):
        uncertain()
    assert uncertain() == uncertain() == "result"
