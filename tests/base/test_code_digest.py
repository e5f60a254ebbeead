"""The digest of all code that computes what is remembered."""

import ast
import platform
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from kennfeld.base import code_digest as module
from kennfeld.base.code_digest import LIBRARIES, code_digest

ROOT = Path(module.__file__).parents[1]
# packages by which recordings become samples
READERS = (
    "base/archives.py",
    "base/column_file.py",
    "base/workbooks",
    "domain/dataset.py",
    "files",
    "matlab",
    "measurement",
    "preprocessing",
)


def imported(name: str) -> Iterator[str]:
    """Yield the other packages that a module or a package imports."""
    path = ROOT / name
    for file in path.rglob("*.py") if path.is_dir() else [path]:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            yield from (each.partition(".")[0] for each in names)


def test_all_libraries_that_read_data_have_a_part_in_it() -> None:
    libraries = {each for name in READERS for each in imported(name)} - sys.stdlib_module_names - {"kennfeld"}
    known = {*LIBRARIES, "fsspec"}  # which copies files as they are
    assert libraries <= known, "add them to LIBRARIES"


def test_another_version_of_a_library_or_of_python_is_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    digests = {code_digest.__wrapped__()}
    version = module._version
    monkeypatch.setattr(module, "_version", lambda library: "99" if library == "pint" else version(library))
    digests.add(code_digest.__wrapped__())
    monkeypatch.setattr(platform, "python_version", lambda: "3.99.0")
    digests.add(code_digest.__wrapped__())
    assert len(digests) == 3
