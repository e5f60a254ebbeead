"""Threads of linear algebra in the process of the command."""

import os
import subprocess
import sys

import pytest

CODE = """
import os, sys
from kennfeld import cli
cli.run = lambda arguments: print(os.environ["OPENBLAS_THREAD_TIMEOUT"], "numpy" in sys.modules)
cli.main()
"""


@pytest.mark.parametrize(("own", "expected"), [({}, "4"), ({"OPENBLAS_THREAD_TIMEOUT": "20"}, "20")])
def test_they_are_told_to_sleep_before_numpy_is_loaded(own: dict[str, str], expected: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_THREAD_TIMEOUT"} | own
    assert subprocess.check_output([sys.executable, "-c", CODE], env=environment, text=True).split() == [
        expected,
        "False",
    ]
