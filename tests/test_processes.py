"""Processes start as fresh interpreters on all systems, as Windows and macOS start them: none is a fork."""

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "src" / "kennfeld"


def imported(text):
    """Yield the modules and names that a file imports, and the attributes of `os` that it uses."""
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Import(names=names):
                yield from (alias.name for alias in names)
            case ast.ImportFrom(module=str(module), names=names):
                yield from (module, *(f"{module}.{alias.name}" for alias in names))
            case ast.Attribute(value=ast.Name(id="os"), attr=name):
                yield f"os.{name}"


@pytest.mark.skipif(not PACKAGE.is_dir(), reason="the sources are not part of an installed package")
def test_the_package_forks_no_process():
    texts = (path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    processes = re.compile(r"subprocess|multiprocessing|fork|ProcessPool")
    used = {name for text in texts if processes.search(text) for name in imported(text)}
    assert "subprocess" in used
    assert {name for name in used if name.partition(".")[0] == "multiprocessing"} == set()
    assert used.isdisjoint({"os.fork", "os.forkpty", "concurrent.futures.ProcessPoolExecutor"})


def test_workers_of_a_local_cluster_are_spawned():
    pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    assert dask.config.get("distributed.worker.multiprocessing-method") == "spawn"
