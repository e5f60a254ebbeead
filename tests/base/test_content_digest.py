"""Digests of values: equal for equal contents in every process, different otherwise."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.content_digest import digest_of


@dataclass(frozen=True)
class Pair:
    left: object
    right: object


VALUES = [
    *(1, 1.0, True, "1", b"1", None, (1,), [1], {"a": 1}, {"a": 1.0}, {"b": 1}, frozenset("ab"), -0.0, 0.0, "x"),
    *(np.arange(3), np.arange(3.0), np.arange(3.0).reshape(3, 1), Pair(1, (2, 3)), Pair((1, 2), 3)),
    *((1, (2,), 3), (1, (2, 3)), Path("x")),
]


def test_different_values_have_different_digests():
    assert len({digest_of(value) for value in VALUES}) == len(VALUES)


def test_other_processes_compute_the_same():
    values = "frozenset(['a', 'b', 'c']), {'x': (1.5, None)}"
    code = f"from kennfeld.base.content_digest import digest_of; print(digest_of({values}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == digest_of(frozenset("cba"), {"x": (1.5, None)})


def test_a_function_has_no_digest():
    with pytest.raises(TypeError, match="a function has no digest"):
        digest_of(lambda: None)
