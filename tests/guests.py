"""Leaves out what needs the importers, the guests in the folders of `kennfeld.importers`, where they are absent.

`scripts/core` runs the tests of the core so. What a test module itself imports decides, not what fails: a module of the
core that needs a guest is an error.
"""

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from kennfeld import _MODULE_OF

ROOT = Path(__file__).parents[1]
GUESTS = "kennfeld.importers"


@cache
def guests_are_absent() -> bool:
    spec = find_spec(GUESTS)
    places = [] if spec is None else spec.submodule_search_locations or []
    return not any(each.is_file() for place in places for each in Path(place).glob("*/importer.py"))


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out the tests of the guests, and other modules that import one."""
    if not guests_are_absent() or not collection_path.name.startswith("test_") or collection_path.is_dir():
        return None
    is_of_guest = collection_path.is_relative_to(ROOT / "tests" / "importers")
    return True if is_of_guest or imports_guest(collection_path) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the tests with the mark `guests`."""
    if not guests_are_absent():
        return
    absent = [item for item in items if item.get_closest_marker("guests") is not None]
    config.hook.pytest_deselected(items=absent)
    items[:] = [item for item in items if item not in set(absent)]


@cache
def imports_guest(path: Path) -> bool:
    """Return whether a module imports a guest when it is loaded, itself or by helpers beside the tests."""
    names = list(imported_names(path))
    if any(name.startswith(f"{GUESTS}.") for name in names):
        return True
    return any(imports_guest(helper) for helper in dict.fromkeys(map(helper_of, names)) if helper is not None)


def imported_names(path: Path) -> Iterator[str]:
    """Yield the modules that a module imports when it is loaded, and what may be modules in packages.

    >>> "pathlib.Path" in imported_names(Path(__file__))
    True
    """
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Import):
            yield from (name.name for name in statement.names)
        elif isinstance(statement, ast.ImportFrom) and statement.module is not None:
            yield statement.module
            yield from (f"{statement.module}.{name.name}" for name in statement.names)


def helper_of(name: str) -> Path | None:
    """Return the file of a module of `tests` or `scripts`; None for others."""
    relative = Path(*name.split(".")).with_suffix(".py")
    return next((path for folder in (ROOT, ROOT / "scripts") if (path := folder / relative).is_file()), None)


def marked(names: Iterable[str]) -> list[Any]:
    """Return public names of `kennfeld` as parameters of a test, those of importers with the mark."""
    return [
        pytest.param(name, marks=pytest.mark.guests) if _MODULE_OF.get(name, "").startswith("importers.") else name
        for name in names
    ]
