"""Changes of a project file: nothing else in it changes, and what was set back leaves no trace."""

import tomllib
from copy import deepcopy
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.project import demo
from kennfeld.project.document import ProjectDocument
from kennfeld.project.schema import read_project
from kennfeld.project.surrogate_training import TrainingFile
from tests.draws import few_or_many, mostly_slow

FOLDERS = (Path(__file__).parents[2] / "examples", Path(demo.__file__).parent)
EXAMPLES = sorted(path for folder in FOLDERS for path in folder.rglob("*.toml"))

TEXT = """\
# a project
[model]   # the function
file = "a.kf"  # text
bind = { "A/B" = "x", C = 'y' }   # of blocks

[[dataset]]
files = ["a.csv",   # the first
    "b.csv"]  # the last
shift.Torque = -1.0
shift."n m" = "auto"
steady = [{ channel = "n", window = 5 }, { channel = "m", window = 3, tolerance = 1 }]

# fresh data
[[dataset]]
  files = "fresh.csv"
  where = \'\'\'a < "3" ]\'\'\'
[dataset.shift]
n = 1

[parameters.Gain]
bounds = [ -1e2, +1_000 ] # wide
x.input = "n"
x.count = 0x5

[optimizer]
starts = 4

[parameters."Map 1"]
initial = [[1, 2],
           # the second row
           [3, 4]]
lock = [ { x = [1, 2] }, ]

[[criterion]]
node = "y"
target = 1
[[criterion.regions]]
where = "a"

[[criterion]]
node = "z"
target = 2

[channels]
"""


def paths_in(value, path=()):
    """The paths of all values of a file, those of tables too."""
    if path:
        yield path
    if isinstance(value, dict):
        items = value.items()
    else:
        is_tables = isinstance(value, list) and all(isinstance(item, dict) for item in value)
        items = enumerate(value, 1) if is_tables else ()
    for key, inner in items:
        yield from paths_in(inner, (*path, key))


def changed(values, path, value):
    """The tables with another value at a path; with None, without it."""
    values = deepcopy(values)
    inner = values
    for key in path[:-1]:
        inner = inner[key - 1] if isinstance(key, int) else inner[key]
    last = path[-1] - 1 if isinstance(path[-1], int) else path[-1]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return values


def pruned(value):
    """Without empty tables and lists of them, which a heading may or may not name."""
    if isinstance(value, dict):
        return {key: pruned(inner) for key, inner in value.items() if pruned(inner) not in ({}, [])}
    return [pruned(inner) for inner in value] if isinstance(value, list) else value


def values_of(document):
    return tomllib.loads(document.text.removeprefix("\ufeff"))


def check_every_path(text):
    check_paths(text, paths_in(tomllib.loads(text.removeprefix("\ufeff"))))


def check_paths(text, paths):
    plain = text.removeprefix("\ufeff")
    values = tomllib.loads(plain)
    for path in paths:
        document = ProjectDocument(text)
        before = document.get(*path)
        other = "another" if before != "another" else 7
        table = {"p": 1, "q r": [1.5, "b"]}
        for value in (table,) if isinstance(path[-1], int) else (other, table):
            document.set(path, value)
            assert pruned(values_of(document)) == pruned(changed(values, path, value)), (path, value)
            document.set(path, before)
            assert document.text == text, (path, value)
        document.remove(path)
        assert pruned(values_of(document)) == pruned(changed(values, path, None)), path
        if document.get(*path[:-1]) is not None and not isinstance(path[-1], int):
            document.set(path, before)
            assert document.text == text, path


FORMS = {
    "plain": TEXT,
    "windows": TEXT.replace("\n", "\r\n"),
    "marked": "\ufeff" + TEXT,
    "unfinished": TEXT.removesuffix("\n"),
    "without empty lines": TEXT.replace("\n\n", "\n"),
}


OTHER_FORMS = [form for form in FORMS if form != "plain"]


@pytest.mark.parametrize("share", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_restoring_a_value_restores_the_text(share):
    check_paths(TEXT, [*paths_in(tomllib.loads(TEXT))][::share])


@pytest.mark.slow
@pytest.mark.parametrize("form", mostly_slow(OTHER_FORMS, ["windows", "unfinished"]))
def test_restoring_a_value_restores_text_in_another_form(form):
    paths = [*paths_in(tomllib.loads(TEXT))]
    check_paths(FORMS[form], paths[OTHER_FORMS.index(form) :: len(OTHER_FORMS)])


@pytest.mark.slow
@pytest.mark.parametrize("form", OTHER_FORMS)
def test_restoring_any_value_restores_text_in_another_form(form):
    check_every_path(FORMS[form])


def kind_of(path, value):
    """A path without numbers and names of parameters, and how its value is written."""
    named = path[:1] == ("parameters",)
    keys = ("" if isinstance(key, int) or (named and at == 1) else key for at, key in enumerate(path))
    return *keys, type(value)


@cache
def first_of_each_kind():
    """For each example, the paths that are of another kind than those of the examples before."""
    kinds, paths = set(), {}
    for file in EXAMPLES:
        text = file.read_text(encoding="utf-8")
        document, paths[file] = ProjectDocument(text), []
        for path in paths_in(tomllib.loads(text)):
            kind = kind_of(path, document.get(*path))
            if kind not in kinds:
                kinds.add(kind)
                paths[file].append(path)
    return paths


@pytest.mark.parametrize(
    "path",
    mostly_slow(EXAMPLES, [path for path in EXAMPLES if path.parent.name in ("demo", "nox", "simulink")]),
    ids=lambda path: f"{path.parent.name}/{path.name}",
)
def test_restoring_a_value_of_each_kind_restores_an_example(path):
    check_paths(path.read_text(encoding="utf-8"), first_of_each_kind()[path])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["simulink/kennfeld.toml", "engine-transient/manifold.toml"])
def test_restoring_any_value_restores_an_example(name):
    check_every_path((FOLDERS[0] / name).read_text(encoding="utf-8"))


@few_or_many(data=st.data(), form=st.sampled_from(sorted(FORMS)), few=7, many=40)
def test_several_changes_in_any_order_do_not_affect_the_rest(data, form):
    check_changes(data, form)


@pytest.mark.slow
@settings(max_examples=100)
@given(data=st.data(), form=st.sampled_from(sorted(FORMS)))
def test_several_changes_in_many_orders_do_not_affect_the_rest(data, form):
    check_changes(data, form)


def check_changes(data, form):
    document = ProjectDocument(FORMS[form])
    values = values_of(document)
    tables = {path[:length] for path in paths_in(values) for length in range(len(path))}
    leaves = [path for path in paths_in(values) if path not in tables]
    before = {path: document.get(*path) for path in leaves if not isinstance(path[-1], int)}
    chosen = data.draw(st.lists(st.sampled_from(sorted(before, key=str)), min_size=1, max_size=4, unique=True))
    for number, path in enumerate(chosen):
        document.set(path, f"new {number}")
        values = changed(values, path, f"new {number}")
        assert values_of(document) == values
    for path in data.draw(st.permutations(chosen)):
        document.set(path, before[path])
    assert values_of(document) == tomllib.loads(FORMS[form].removeprefix("\ufeff"))
    assert document.text.count("#") == FORMS[form].count("#") or any(
        path[-1] in ("files", "initial") for path in chosen
    )


def test_comments_and_notation_around_a_value_stay():
    document = ProjectDocument(TEXT)
    document.set(("model", "file"), "b.kf")
    document.set(("dataset", 1, "shift", "Torque"), 2.5)
    document.set(("parameters", "Gain", "x", "count"), 8)
    document.set(("model", "bind", "A/B"), "z")
    expected = TEXT.replace('"a.kf"', '"b.kf"').replace("-1.0", "2.5").replace("0x5", "8").replace('"x", C', '"z", C')
    assert document.text == expected


def test_a_new_key_stands_at_the_end_of_its_section():
    document = ProjectDocument(TEXT)
    document.set(("optimizer", "seed"), 3)
    document.set(("dataset", 2, "name"), "fresh")
    document.set(("model", "bind", "D"), "w")
    document.set(("parameters", "Gain", "x", "begin"), 1.0)
    expected = TEXT.replace("starts = 4\n", "starts = 4\nseed = 3\n").replace("C = 'y' }", "C = 'y', D = \"w\" }")
    expected = expected.replace("]'''\n", "]'''\n  name = \"fresh\"\n").replace("0x5\n", "0x5\nx.begin = 1.0\n")
    assert document.text == expected


def test_a_new_part_of_an_entry_stands_within_it():
    document = ProjectDocument(TEXT)
    document.set(("criterion", 1, "regions", 2), {"where": "b"})
    assert document.text == TEXT.replace('where = "a"\n', 'where = "a"\n\n[[criterion.regions]]\nwhere = "b"\n')
    document.remove(("criterion", 1, "regions", 2))
    assert document.text == TEXT


def test_new_sections_stand_in_the_documented_order():
    document = ProjectDocument('[model]\nfile = "a.kf"\n\n[[criterion]]\nnode = "y"\ntarget = 1\n')
    document.set(("optimizer", "seed"), 1)
    document.set(("parameters", "Gain", "bounds"), [0, float("inf")])
    document.set(("dataset", 1), {"files": ["a.csv"], "steady": {"channel": "n"}})
    document.set(("units", "time"), "ms")
    document.set(("dataset", 2, "files"), "b.csv")
    document.set(("parameters", "my map"), {"free": False})
    assert document.text == (
        '[model]\nfile = "a.kf"\n\n[units]\ntime = "ms"\n\n'
        '[[dataset]]\nfiles = ["a.csv"]\nsteady = { channel = "n" }\n\n[[dataset]]\nfiles = "b.csv"\n\n'
        '[parameters.Gain]\nbounds = [0, inf]\n\n[parameters."my map"]\nfree = false\n\n'
        '[[criterion]]\nnode = "y"\ntarget = 1\n\n[optimizer]\nseed = 1\n'
    )


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ('model.file = "a.kf"  # the sensor\n', ("parameters", "Gain"), {"initial": 1.0}),
        ('model.file = "a.kf"', ("parameters",), {"Gain": {"initial": 1.0}, "Offset": {"initial": 0.0}}),
        ('model.file = "a.kf"\r\noptimizer.starts = 2\r\n', ("dataset", 1), {"files": "a.csv"}),
        ('# text\n\nmodel = { file = "a.kf" }\n\n[[dataset]]\nfiles = "a.csv"\n', ("channels", "u"), "v"),
        ("parameters = { Gain = { initial = 1.0 } }\n", ("parameters", "Offset"), {"initial": 0.0}),
    ],
)
def test_a_new_section_takes_in_no_keys_without_a_heading(text, path, value):
    document = ProjectDocument(text)
    others = {key: inner for key, inner in tomllib.loads(text).items() if key != path[0]}

    document.set(path, value)

    assert document.get(*path) == value
    assert others.items() <= tomllib.loads(document.text).items()


def test_a_training_file_has_its_own_order():
    document = ProjectDocument('[[dataset]]\nfiles = "a.csv"\n', entry=TrainingFile)
    document.set(("surrogate", "output"), "y")
    assert document.text == '[surrogate]\noutput = "y"\n\n[[dataset]]\nfiles = "a.csv"\n'


def test_a_saved_document_has_the_new_section_at_its_end(shop):
    document = ProjectDocument.read(shop.path)
    document.set(("optimizer", "starts"), 3)
    document.save()
    assert shop.folder.joinpath("kennfeld.toml").read_text() == shop.toml + "\n[optimizer]\nstarts = 3\n"
    assert read_project(shop.folder / "kennfeld.toml").optimizer.starts == 3


def test_a_document_without_valid_toml_is_refused(shop):
    shop.toml = "[model"
    with pytest.raises(InputError, match="line 1"):
        ProjectDocument.read(shop.path)


@pytest.mark.parametrize(
    ("text", "path", "expected"),
    [
        ("[model]\nfile = 'a'\n\n[optimizer]\nstarts = 4\n", ("optimizer", "starts"), "[model]\nfile = 'a'\n"),
        ("[parameters.A]\ngradient = { x = [0, 1] }\n", ("parameters", "A", "gradient", "x"), ""),
        ("[optimizer]\n# four\nstarts = 4\n", ("optimizer", "starts"), "[optimizer]\n# four\n"),
        ("[[step]]\nname = 'a'\n", ("step", 1, "name"), "[[step]]\n"),
        ("[[dataset]]\nfiles = 'a'\nshift.n = 1\n", ("dataset", 1, "shift", "n"), "[[dataset]]\nfiles = 'a'\n"),
    ],
)
def test_empty_tables_are_removed_unless_they_have_a_meaning(text, path, expected):
    document = ProjectDocument(text)
    document.remove(path)
    document.remove_empty(path[:-1])
    assert document.text == expected


def test_the_notation_of_an_earlier_text_is_restored_with_its_values():
    text = "[parameters.A]\r\nsmoothness = 1e4  # large\r\n"
    changed = ProjectDocument(text)
    changed.set(("parameters", "A", "smoothness"), 5)
    document = ProjectDocument(changed.text, earlier=[text])
    document.set(("parameters", "A", "smoothness"), 10000)
    assert document.text == text
