"""The stable names of `docs/stability.md` exist, with the arguments of `stable_arguments.json`.

An argument that is missing here was removed or renamed: the page says how that is done. After a deprecation has run
out, or to pin what was added, write the file anew: python -m tests.test_stability
"""

import inspect
import json
import re
from pathlib import Path

import pytest

import kennfeld
from tests.guests import marked

PAGE = Path(__file__).parents[1] / "docs" / "stability.md"
ARGUMENTS = Path(__file__).with_name("stable_arguments.json")
PROVISIONAL = {
    *("DynamicSurrogate", "FilteredSurrogate", "StaticSurrogate", "SurrogateSettings", "train_surrogate"),
    *("compress_map", "find_extrapolation", "inspect_simulink", "import_esdl", "import_simulink", "read_surrogate"),
    *("write_surrogate", "report", "Export", "export_function", "design"),
    *("propose", "TermProposal", "TermProposals"),
}
# values that only this package makes, from what users state otherwise
MADE = {
    *("CrossValidation", "DynamicSurrogate", "FilteredSurrogate", "Graph", "Model", "Problem", "Project", "Quality"),
    *("RecordingQuality", "Result", "StaticSurrogate", "TraceLine", "Trust", "Finding", "Export"),
}
# in the order of its formula
LONG = {"Expansion"}


def listed(which):
    text = PAGE.read_text(encoding="utf-8")
    (names,) = re.findall(rf"<!-- {which} names -->\n(.*?)<!-- end of {which} names -->", text, re.DOTALL)
    return re.findall(r"`(\w+)`", names)


def is_called(value):
    return callable(value) and not (inspect.isclass(value) and issubclass(value, Exception))


def stable_arguments():
    """Return the arguments of each stable name that can be called, in their order."""
    arguments = {}
    for name in sorted(set(kennfeld.__all__) - PROVISIONAL - MADE):
        value = getattr(kennfeld, name)
        if is_called(value):
            arguments[name] = list(inspect.signature(value).parameters)
    return arguments


def test_every_public_name_is_listed_as_stable_or_provisional():
    assert listed("stable") == sorted(set(kennfeld.__all__) - PROVISIONAL, key=lambda name: (name.casefold(), name))
    assert listed("provisional") == sorted(PROVISIONAL, key=lambda name: (name.casefold(), name))


@pytest.mark.guests
def test_no_argument_of_a_stable_name_was_removed():
    pinned, present = json.loads(ARGUMENTS.read_text("utf-8")), stable_arguments()
    assert {name: [each for each in own if each not in present.get(name, ())] for name, own in pinned.items()} == {
        name: [] for name in pinned
    }
    assert pinned == present, "pin what was added: python -m tests.test_stability"


@pytest.mark.parametrize("name", marked(sorted(set(kennfeld.__all__) - MADE)))
def test_arguments_beyond_the_fourth_are_passed_by_name(name):
    value = getattr(kennfeld, name)
    if not is_called(value):
        return
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    positional = [each.name for each in inspect.signature(value).parameters.values() if each.kind in kinds]
    assert len(positional) <= 4 or name in LONG


def _write():
    ARGUMENTS.write_text(json.dumps(stable_arguments(), indent=1) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    for which, names in (("stable", set(kennfeld.__all__) - PROVISIONAL), ("provisional", PROVISIONAL)):
        line = ", ".join(f"`{name}`" for name in sorted(names, key=lambda name: (name.casefold(), name)))
        block = f"<!-- {which} names -->\n{line}\n<!-- end of {which} names -->"
        text = re.sub(rf"<!-- {which} names -->.*?<!-- end of {which} names -->", block, text, flags=re.DOTALL)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    _write()
