"""Entries of every section, written into a file and read again."""

import math
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from kennfeld.base.errors import Findings
from kennfeld.calfiles import endings
from kennfeld.project import forms, surrogate_training, value_forms
from kennfeld.project.document import ProjectDocument
from kennfeld.project.schema import ChannelsForm, ProjectFile
from kennfeld.project.section import KeyLocation, Section
from kennfeld.project.surrogate_training import TrainingFile
from tests.draws import few_or_many

numbers = st.floats(allow_nan=False, allow_infinity=False)
ends = st.floats(allow_nan=False)
letters = st.characters(exclude_categories=("Cs", "Cc"), include_characters="\t\n\x7f\x01")
names = st.text(letters, min_size=1, max_size=6).filter(lambda text: text.strip())
directions = st.sampled_from(value_forms.DIRECTIONS)
pairs = st.tuples(ends, ends).filter(lambda pair: pair[0] < pair[1])
arrays = st.one_of(numbers.map(np.array), st.lists(numbers, min_size=1, max_size=3).map(np.array))


def number(form):
    least = form.least if form.above is None else math.nextafter(form.above, math.inf)
    plain = st.floats(min_value=least, allow_nan=False, allow_infinity=False)
    return st.one_of(plain, st.sampled_from(form.words)) if form.words else plain


def table_of(form):
    keys = st.sampled_from(form.names) if form.names else names.filter(lambda name: name != "calculated")
    return st.dictionaries(keys, strategy(form.values), max_size=2)


def entry_of(entry, **further):
    """Entries with any of the keys."""
    keys = {part.name: strategy(forms.form_of(part)) for part in forms.keys_of(entry).values()}
    needed = [part.name for part in forms.keys_of(entry).values() if forms.is_required(part)]
    others = {"location": KeyLocation(), "name": "m"} | further
    others = {part: value for part, value in others.items() if part in entry.__dataclass_fields__ and part not in keys}
    required = {name: keys.pop(name) for name in needed}
    return st.fixed_dictionaries(required, optional=keys).map(lambda values: entry(**others, **values))


STRATEGIES = {
    forms.TextForm: lambda form: names,
    forms.NumberForm: number,
    forms.IntegerForm: lambda form: st.integers(form.least, form.most),
    forms.FlagForm: lambda form: st.booleans(),
    forms.ChoiceForm: lambda form: st.sampled_from(form.words),
    forms.TextsForm: lambda form: st.lists(names, min_size=1, max_size=3, unique=True).map(tuple),
    forms.TableOfForm: table_of,
    ChannelsForm: table_of,
    forms.EitherForm: lambda form: st.one_of(strategy(form.plain), strategy(form.table)),
    forms.EntryForm: lambda form: entry_of(form.entry),
    forms.EntriesForm: lambda form: st.lists(entry_of(form.entry), min_size=1, max_size=2).map(tuple),
    forms.NamedEntriesForm: lambda form: st.dictionaries(names, entry_of(form.entry), max_size=2),
    value_forms.ArrayForm: lambda form: arrays,
    value_forms.BoundsForm: lambda form: pairs.map(lambda pair: tuple(map(np.array, pair))),
    value_forms.BreakpointsForm: lambda form: st.one_of(
        st.just("free"), st.lists(numbers, min_size=1, max_size=4, unique=True).map(lambda x: tuple(sorted(x)))
    ),
    value_forms.PairForm: lambda form: pairs,
    value_forms.LimitPairForm: lambda form: pairs,
    value_forms.CoordinatesForm: lambda form: st.lists(numbers, max_size=3).map(tuple),
    value_forms.LockForm: lambda form: st.one_of(
        st.booleans(),
        st.just("no-data"),
        st.lists(st.dictionaries(directions, pairs, min_size=1), max_size=2).map(tuple),
    ),
    value_forms.TargetForm: lambda form: st.one_of(
        numbers.map(lambda x: value_forms.TargetEntry("number", value=x)),
        st.builds(value_forms.TargetEntry, st.sampled_from(["name", "channel", "node"]), names),
    ),
    forms.FilesForm: lambda form: st.lists(
        st.one_of(names, entry_of(form.entry)), min_size=1, max_size=2, unique=True
    ).map(tuple),
    value_forms.InitialForm: lambda form: st.lists(
        st.one_of(names, st.builds(value_forms.ImageEntry, names, names)), min_size=1, max_size=2, unique=True
    ).map(tuple),
    value_forms.OutputForm: lambda form: st.lists(st.sampled_from(endings()), min_size=1, unique=True).map(tuple),
    value_forms.ResultsForm: lambda form: st.lists(st.sampled_from(form.endings()), min_size=1, unique=True).map(tuple),
    value_forms.StepCriteriaForm: lambda form: st.one_of(
        st.lists(st.one_of(names, st.integers(1, 9)), max_size=3).map(tuple),
        st.dictionaries(st.one_of(st.integers(1, 9)), st.floats(0, 9), max_size=3),
    ),
    surrogate_training.LimitsForm: lambda form: st.one_of(pairs, st.just("auto")),
    surrogate_training.LagsForm: lambda form: st.lists(st.integers(form.least, 9), min_size=1, max_size=3).map(tuple),
    surrogate_training.InputLagsForm: lambda form: st.one_of(st.just("auto"), table_of(form)),
}


def strategy(form):
    return STRATEGIES[type(form)](form)


def read_again(text, entry):
    document = ProjectDocument(text, entry=entry)
    section = Section(document.get(), KeyLocation("kennfeld.toml"), Findings())
    return forms.read_entry(entry, section, path=Path("kennfeld.toml"), lines={})


def check(file):
    """Written into an empty file, section by section, and read again it is the same; so is what is written then."""
    entry = type(file)
    table = forms.write_entry(file)
    document = ProjectDocument("", entry=entry)
    for key, value in reversed(table.items()):
        document.set((key,), value)
    back = read_again(document.text, entry)
    assert forms.write_entry(back) == table


@few_or_many(file=entry_of(ProjectFile, path=Path("kennfeld.toml"), lines={}), few=8, many=100)
def test_a_project_file_survives_writing_and_reading(file):
    check(file)


@few_or_many(file=entry_of(TrainingFile, path=Path("engine.toml"), lines={}), few=15, many=100)
def test_a_training_file_survives_writing_and_reading(file):
    check(file)
