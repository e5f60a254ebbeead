"""Whatever is written: a model, or an `InputError` with findings that have a place."""

import string
from collections.abc import Callable

import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError, Location
from kennfeld.graph import Graph
from kennfeld.models import Model
from kennfeld.models.formula import expression, extend, formula, to_text
from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.models.formula.lexer import DECLARATIONS, RESERVED
from tests.draws import few_or_many
from tests.models.formula_graphs import graphs, one_nan

SIGNS = "a b c y f M K _x 0 1 2 3.5 1e3 %q% %r[1]% [Nm] [ ] ( ) , = == < <= + - * / ^ # % $ ** & \\ . ;"
LINES = ["\n"] * 12 + ["\ny = ", "\ndef f(a) = ", "(", ")"]
WORDS = [*FUNCTIONS, *sorted(DECLARATIONS | RESERVED), *SIGNS.split(), *LINES]
BASE = """
input u[Nm]
scalar K
map M
step 0.1
def f(a, b) = a * b + prev(a, 0)
_h = M(u, z) + K
y[-] = PT1(_h, 0.5) + f(u, delay(z, 3))
z = integrator(u - prev(y, 0), 1, -5, 5)
output z
"""


def answer(way: Callable[[], Model | Graph]) -> Model | Graph | None:
    """Return the model, or None after an `InputError` whose findings all have a place and a message."""
    try:
        return way()
    except InputError as error:
        complete = [str(finding.location).startswith("fuzz.kf") and finding.message != "" for finding in error.findings]
    assert complete
    assert all(complete)
    return None


def read(text: str, known: list[str] | None = None) -> None:
    model = answer(lambda: formula(text, "fuzz.kf", known))
    if isinstance(model, Model):
        assert one_nan(formula(to_text(model.graph)).graph) == one_nan(model.graph)


@few_or_many(
    st.lists(st.sampled_from(WORDS), max_size=60).map(" ".join),
    st.sampled_from([None, [], ["a", "K", "M"]]),
    few=60,
    many=600,
)
def test_a_soup_of_words_is_read_or_answered(text, known):
    read(text, known)


@few_or_many(st.text(st.one_of(st.sampled_from(string.printable), st.characters()), max_size=80), few=50, many=300)
def test_any_text_is_read_or_answered(text):
    read(text)
    read("y = " + text)
    answer(lambda: expression(text, Location("fuzz.kf")))
    answer(lambda: extend(formula(BASE), {"new": text}, Location("fuzz.kf")))


@few_or_many(st.data(), few=50, many=400)
def test_a_text_with_mistakes_is_read_or_answered(data):
    text = BASE
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        end = at + data.draw(st.integers(0, 6))
        text = text[:at] + data.draw(st.sampled_from(["", *WORDS])) + text[end:]
    read(text)


@pytest.mark.slow
@few_or_many(graphs(), st.data(), few=15, many=100)
def test_a_printed_text_with_a_mistake_is_read_or_answered(graph, data):
    text = to_text(graph)
    at = data.draw(st.integers(0, len(text)))
    read(text[:at] + data.draw(st.sampled_from(WORDS)) + text[at + data.draw(st.integers(0, 3)) :])
