"""Names that a stranger can search for: unique classes, files told apart by more than a letter, no private jargon."""

from collections import defaultdict

from tests.source_facts import FILES, SOURCE, facts_of

TREES = {
    "ascet/syntax.py",
    "matlab/syntax.py",
    "models/formula/syntax.py",
}  # their nodes are used with the name of the module
METAPHORS = {"Loom", "Weaver", "Desk", "Climb", "Site", "Inspection", "Knot", "loom", "weaver", "desk", "mend", "climb"}


def test_a_class_name_is_unique():
    places = defaultdict(list)
    for path in FILES:
        name = path.relative_to(SOURCE).as_posix()
        for class_name in () if name in TREES else facts_of(path).classes:
            places[class_name].append(name)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_files_of_a_package_differ_by_more_than_an_ending():
    stems = defaultdict(set)
    for path in FILES:
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
    used = {path.name: facts_of(path).names & METAPHORS for path in FILES}
    assert {name: metaphors for name, metaphors in used.items() if metaphors} == {}
