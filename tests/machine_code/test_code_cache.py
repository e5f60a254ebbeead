"""Machine code that is kept on disk."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.machine_code import code_cache, engine
from kennfeld.machine_code.code_cache import cache_folder, keep_code, key_of, read_code
from kennfeld.native.simulator import Simulator
from models import MODELS, case

KEY = key_of("a module")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv(code_cache.VARIABLE, str(tmp_path / "code"))
    cache_folder.cache_clear()
    yield tmp_path / "code"
    cache_folder.cache_clear()


def test_code_comes_back(folder: Path) -> None:
    assert read_code(KEY) is None
    keep_code(KEY, b"code")
    assert read_code(KEY) == b"code"
    assert read_code(key_of("another module")) is None


@pytest.mark.parametrize("content", [b"", b"short", b"\0" * 32 + b"code", b"\xff" * 500])
def test_damaged_code_is_ignored(folder: Path, content: bytes) -> None:
    keep_code(KEY, b"code")
    (folder / KEY).write_bytes(content)
    assert read_code(KEY) is None


def test_code_under_another_name_is_ignored(folder: Path) -> None:
    keep_code(KEY, b"code")
    other = key_of("another module")
    (folder / KEY).rename(folder / other)
    assert read_code(other) is None


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no permissions of others")
def test_code_that_others_can_write_is_ignored(folder: Path) -> None:
    keep_code(KEY, b"code")
    (folder / KEY).chmod(0o666)
    assert read_code(KEY) is None


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no permissions of others")
def test_a_folder_that_others_can_write_is_not_used(folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)
    assert cache_folder() is None
    keep_code(KEY, b"code")
    assert list(folder.iterdir()) == []


def test_an_empty_variable_keeps_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(code_cache.VARIABLE, "")
    cache_folder.cache_clear()
    keep_code(KEY, b"code")
    assert not folder.exists()
    assert read_code(KEY) is None


def test_what_was_not_used_for_the_longest_time_goes_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code_cache, "LARGEST", 3 * 1032)
    keys = [key_of(str(number)) for number in range(4)]
    for age, key in zip((40, 30, 20), keys[:3], strict=True):
        keep_code(key, b"x" * 1000)
        os.utime(folder / key, (1e9 - age, 1e9 - age))
    assert read_code(keys[0]) is not None  # is used now
    keep_code(keys[3], b"x" * 1000)
    assert [read_code(key) is not None for key in keys] == [True, False, True, True]


def simulated() -> list[np.ndarray]:
    """Return all nodes of all models over random samples."""
    results = []
    for make in MODELS.values():
        model = case(make(), 70, (0, 1, 30))
        lowered = lower_lookups(model.graph, model.parameters)
        simulator = Simulator(lowered, list(lowered.graph.names.values()), model.parameters)
        results.append(simulator.over(model.columns, model.samples, model.parameters, model.starts))
    return results


def test_kept_code_gives_the_same_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_WORTH", 0.0)
    first = simulated()
    files = list(folder.iterdir())
    assert files

    def refuse(*_: object) -> None:
        raise AssertionError("compiled again")

    monkeypatch.setattr(engine, "_tidy", refuse)
    monkeypatch.setattr(engine, "_optimise", refuse)
    for now, before in zip(simulated(), first, strict=True):
        np.testing.assert_array_equal(now, before)


def test_another_process_uses_kept_code(folder: Path) -> None:
    code = """
        import sys
        sys.path[:] = {path!r}
        from test_code_cache import simulated
        from kennfeld.machine_code import engine
        engine._WORTH = 0.0
        print(repr(sum(float(abs(nodes).sum()) for nodes in simulated())))
    """
    path = [str(Path(__file__).parent), *sys.path]
    command = [sys.executable, "-c", dedent(code).format(path=path)]
    environment = {**os.environ, code_cache.VARIABLE: str(folder)}
    first = subprocess.check_output(command, env=environment, text=True)
    kept = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert kept
    assert subprocess.check_output(command, env=environment, text=True) == first
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == kept
