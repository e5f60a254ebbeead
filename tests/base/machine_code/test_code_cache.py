"""Machine code that is kept on disk."""

import os
import subprocess
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from functools import wraps
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from kennfeld.base.machine_code import code_cache, engine, fingerprint
from kennfeld.base.machine_code.code_cache import cache_folder, keep_code, key_of, read_code
from kennfeld.base.machine_code.engine import compile_functions
from kennfeld.base.machine_code.ir import FunctionWriter
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native import kernel, simulator
from kennfeld.native.simulator import Simulator
from kennfeld.native.sweeps import sweeps
from tests.base.machine_code.test_engine import adder
from tests.native.models import MODELS, case
from tests.native.reference import compiled

KEY = key_of("a module")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv(code_cache.VARIABLE, str(tmp_path / "code"))
    monkeypatch.setattr(engine, "_recent", OrderedDict())
    cache_folder.cache_clear()
    yield tmp_path / "code"
    cache_folder.cache_clear()


def test_kept_code_is_read_back(folder: Path) -> None:
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


def test_the_least_recently_used_entry_is_removed_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code_cache, "LARGEST", 3 * 1032)
    monkeypatch.setattr(code_cache, "LIMITED_EVERY", 1)
    keys = [key_of(str(number)) for number in range(4)]
    for age, key in zip((40, 30, 20), keys[:3], strict=True):
        keep_code(key, b"x" * 1000)
        os.utime(folder / key, (1e9 - age, 1e9 - age))
    assert read_code(keys[0]) is not None  # is used now
    keep_code(keys[3], b"x" * 1000)
    assert [read_code(key) is not None for key in keys] == [True, False, True, True]


def computed(names: Iterable[str] = MODELS) -> list[np.ndarray]:
    """Return all nodes of models over random samples, and their costs with derivatives."""
    results = []
    for name in names:
        model = case(MODELS[name](), 70, (0, 1, 30))
        lowered = lower_lookups(model.graph, model.parameters)
        nodes = Simulator(lowered, list(lowered.graph.names.values()), model.parameters)
        results.append(nodes.over(model.columns, model.samples, model.parameters, model.starts))
        code = compiled(model)
        normal = code.accumulator().normal(code.values)
        results += [normal.matrix.copy(), normal.gradient.copy()]
    return results


def test_kept_code_gives_the_same_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_WORTH", 0.0)
    sweeps.cache_clear()
    first = computed(["delayed", "layers"])
    files = list(folder.iterdir())
    assert files

    def refuse(*_: object) -> None:
        raise AssertionError("written or compiled again")

    monkeypatch.setattr(engine, "_object_code", refuse)
    monkeypatch.setattr(kernel, "_kernel_code", renamed(refuse, kernel._kernel_code))
    monkeypatch.setattr(simulator, "_simulator_code", renamed(refuse, simulator._simulator_code))
    sweeps.cache_clear()
    engine._recent.clear()
    for now, before in zip(computed(["delayed", "layers"]), first, strict=True):
        np.testing.assert_array_equal(now, before)


@pytest.mark.parametrize("text", [True, False], ids=["text", "a writer"])
def test_another_version_of_the_package_compiles_anew(
    text: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_WORTH", 0.0)

    def kept() -> int:
        if text:
            compile_functions(adder(1.0))
        else:
            engine.compile_written(named_writer, 1)
        return len(list(folder.iterdir()))

    assert [kept(), kept()] == [1, 1]
    monkeypatch.setattr(fingerprint, "_source_hash", lambda: "another")
    assert kept() == 2


def named_writer(count: int) -> list[FunctionWriter]:
    return [FunctionWriter(f"nothing{count}", [("ptr", "x")])]


named_writer.__module__ = "kennfeld.native.a_writer"


@pytest.mark.parametrize("damage", ["bit", "cut", "empty", "zeros", "swapped", "folder", "link"])
def test_damaged_code_is_compiled_anew(damage: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_WORTH", 0.0)

    def results() -> list[float]:
        sums = []
        for value in (1.0, 1.0 + 2**-52):  # equal but for the last bit of a constant
            x = np.zeros(1)
            compile_functions(adder(value))["put"](x.ctypes.data, 1)
            sums.append(float(x[0]))
        return sums

    expected = results()
    files = sorted(folder.iterdir())
    contents = [file.read_bytes() for file in files]
    assert len(files) == len(set(expected)) == 2
    for file, content, other in zip(files, contents, contents[::-1], strict=True):
        middle = len(content) // 2
        flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
        damaged = {"bit": flipped, "cut": content[:middle], "empty": b"", "zeros": bytes(len(content))}
        if damage in ("folder", "link"):
            file.unlink()
        if damage == "folder":
            file.mkdir()
        elif damage == "link":
            target = folder.parent / file.name
            target.write_bytes(other)
            file.symlink_to(target)
        else:
            file.write_bytes(damaged.get(damage, other))
    assert results() == expected


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that begin as copies of this one")
def test_a_full_disk_and_four_writers_keep_nothing_wrong(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(code_cache, "write_whole", fail)
        keep_code(KEY, b"code")
    assert read_code(KEY) is None
    content = b"x" * 100_000
    children = []
    for _ in range(4):
        child = os.fork()
        if not child:
            for _ in range(20):
                keep_code(KEY, content)
            os._exit(read_code(KEY) != content)
        children.append(child)
    assert [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children] == [0] * 4
    assert [file.name for file in folder.iterdir()] == [KEY]


def renamed(function: Callable[..., Any], other: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that goes by the name of another one."""
    return wraps(other)(lambda *arguments: function(*arguments))


@pytest.mark.slow
def test_another_process_uses_kept_code(folder: Path) -> None:
    code = """
        import sys
        sys.path[:] = {path!r}
        from test_code_cache import computed
        from kennfeld.base.machine_code import engine
        engine._WORTH = 0.0
        print(repr(sum(float(abs(numbers).sum()) for numbers in computed(['lag', 'layers']))))
    """
    path = [str(Path(__file__).parent), *sys.path]
    command = [sys.executable, "-c", dedent(code).format(path=path)]
    environment = {**os.environ, code_cache.VARIABLE: str(folder)}
    first = subprocess.check_output(command, env=environment, text=True)
    kept = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert kept
    assert subprocess.check_output(command, env=environment, text=True) == first
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == kept
