"""The examples in the docstrings of scripts run."""

import doctest
import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPTS = [ROOT / "docs" / "conf.py", *sorted((ROOT / "scripts").glob("*.py"))]
WITH_EXAMPLES = [path for path in SCRIPTS if ">>> " in path.read_text(encoding="utf-8")]
NEEDS = {"conf": "yaml"}


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: path.stem)
def test_examples_of_scripts_run(path, monkeypatch):
    pytest.importorskip(NEEDS.get(path.stem, "kennfeld"))
    monkeypatch.syspath_prepend(path.parent)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, path.stem, module)  # where doctest looks up the module of a class
    spec.loader.exec_module(module)
    failed, attempted = doctest.testmod(module)
    assert attempted
    assert failed == 0
