"""Collects doctests from modules with examples alone: to load and search the others takes seconds."""

from pathlib import Path

import pytest
from _pytest.doctest import DoctestModule


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> object:
    collectors = yield
    return [each for each in collectors if not isinstance(each, DoctestModule) or has_examples(file_path)]


def has_examples(path: Path) -> bool:
    return ">>> " in path.read_text(encoding="utf-8")
