"""Names that a stranger can search for: unique classes, files told apart by more than a letter, no private jargon."""

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "kennfeld"
TREES = {
    "ascet/syntax.py",
    "matlab/syntax.py",
    "models/formula/syntax.py",
}  # their nodes are used with the name of the module
METAPHORS = {"Loom", "Weaver", "Desk", "Climb", "Site", "Inspection", "Knot", "loom", "weaver", "desk", "mend", "climb"}


@cache
def modules() -> dict[Path, ast.Module]:
    """Return the tree of each file of the package."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(SOURCE.rglob("*.py"))}


def test_a_class_name_is_unique():
    places = defaultdict(list)
    for path, tree in modules().items():
        name = path.relative_to(SOURCE).as_posix()
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and name not in TREES:
                places[node.name].append(name)
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
    used = set()
    for tree in modules().values():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                used.add(node.name)
            elif isinstance(node, ast.Name):
                used.add(node.id)
            elif isinstance(node, ast.arg):
                used.add(node.arg)
    assert used & METAPHORS == set()
