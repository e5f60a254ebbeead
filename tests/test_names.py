"""Names that a stranger can search for: unique classes, files told apart by more than a letter, no private jargon."""

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "kennfeld"
TREES = {
    "ascet/syntax.py",
    "program/tree.py",
    "models/formula/syntax.py",
}  # their nodes are used with the name of the module
VAGUE = {"found", "given", "made", "told"}  # of a local: what it is says more than how one came by it
RIDDLE = r"def (test_\w*(?:_told|(?<!_there)_(?:is|are)_(?:said|no)|_aside)(?:_\w+)?)\("
TESTS = Path(__file__).parent
METAPHORS = {"Loom", "Weaver", "Desk", "Climb", "Site", "Inspection", "Knot", "loom", "weaver", "desk", "mend", "climb"}


@cache
def modules() -> dict[Path, str]:
    """Return the text of each file of the package."""
    return {path: path.read_text(encoding="utf-8") for path in sorted(SOURCE.rglob("*.py"))}


def names(tree: ast.Module) -> set[str]:
    """Return the names of functions, classes, arguments and variables of a module."""
    used = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            used.add(node.name)
        elif isinstance(node, ast.Name):
            used.add(node.id)
        elif isinstance(node, ast.arg):
            used.add(node.arg)
    return used


def test_a_class_name_is_unique():
    places = defaultdict(list)
    for path, text in modules().items():
        name = path.relative_to(SOURCE).as_posix()
        for class_name in () if name in TREES else re.findall(r"^class (\w+)", text, re.MULTILINE):
            places[class_name].append(name)
    assert "ParameterSet" in places
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_files_of_a_package_differ_by_more_than_an_ending():
    stems = defaultdict(set)
    for path in modules():
        stems[path.parent].add(path.stem)
    endings = ("s", "ing", "er", "ed")
    close = [
        f"{folder.name}/{stem}{end}"
        for folder, names in stems.items()
        for stem in names
        for end in endings
        if stem + end in names
    ]
    assert close == []


def test_nothing_is_named_by_a_metaphor():
    mentioned = {path: text for path, text in modules().items() if not METAPHORS.isdisjoint(re.findall(r"\w+", text))}
    assert [path.name for path, text in mentioned.items() if names(ast.parse(text)) & METAPHORS] == []


def assigned(text: str) -> set[str]:
    """Return the names of functions and assigned variables of a module."""
    nodes = list(ast.walk(ast.parse(text)))
    functions = {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
    return functions | {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


@pytest.mark.parametrize("folder", sorted({path.parent.name for path in TESTS.glob("*/*.py")}))
def test_tests_are_named_by_what_they_check_and_locals_by_what_they_are(folder):
    texts = {path: path.read_text(encoding="utf-8") for path in sorted((TESTS / folder).rglob("*.py"))}
    assert [riddle for text in texts.values() for riddle in re.findall(RIDDLE, text)] == []
    bound = re.compile(r"\b(?:{0})\b(?:.* (?:=|in) |:\n)|def (?:{0})\(".format("|".join(VAGUE)))
    likely = {path.name: text for path, text in texts.items() if bound.search(text)}
    assert {name: vague for name, text in likely.items() if (vague := assigned(text) & VAGUE)} == {}
