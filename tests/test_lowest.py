"""The oldest versions that pyproject.toml admits, as `scripts/lowest` tests them."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def lowest():
    spec = importlib.util.spec_from_file_location("lowest_versions", ROOT / "scripts" / "lowest_versions.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.lowest


def test_every_dependency_of_this_project_states_one(lowest):
    constraints = list(lowest((ROOT / "pyproject.toml").read_text(encoding="utf-8")))
    assert {"numpy", "llvmlite", "pytest"} <= {constraint.partition("==")[0] for constraint in constraints}
    assert all(constraint.partition("==")[2] for constraint in constraints)


def test_extras_of_a_dependency_are_left_out(lowest):
    assert list(lowest('[project]\ndependencies = ["canmatrix[arxml,kcd]>=1.2"]\n')) == ["canmatrix==1.2"]


@pytest.mark.parametrize("requirement", ["numpy", "numpy<3", "numpy>=1.26,<3"])
def test_a_dependency_that_states_none_or_more_is_refused(lowest, requirement):
    with pytest.raises(ValueError, match="must have the form name>=version"):
        list(lowest(f'[project]\ndependencies = ["{requirement}"]\n'))


def test_the_files_that_are_tested_with_them_exist():
    script = (ROOT / "scripts" / "lowest").read_text(encoding="utf-8")
    paths = [path for pattern in re.findall(r"tests/\S+", script) for path in expanded(pattern)]
    assert len(paths) > 10
    assert [path for path in paths if not (ROOT / path).exists()] == []


def expanded(pattern):
    """Return the paths of a pattern with alternatives in braces, as the shell expands them."""
    head, brace, rest = pattern.partition("{")
    if not brace:
        return [pattern]
    names, _, tail = rest.partition("}")
    return [f"{head}{name}{tail}" for name in names.split(",")]
