"""Whatever is written: a model, or an `InputError` with findings that have a place."""

import string

from hypothesis import given, settings
from hypothesis import strategies as st
from random_graphs import graphs

from kennfeld.errors import InputError
from kennfeld.models.formula import expression, extend, formula, to_text
from kennfeld.models.formula.functions import FUNCTIONS

WORDS = [
    *FUNCTIONS,
    *"input output scalar curve map cube step def and or not if pi dt t inf nan".split(),
    *"a b c y f M K _x 0 1 2 3.5 1e3 %q% %r[1]% [Nm] [ ] ( ) , = == < <= + - * / ^ # % $ ** & \\ . ;".split(),
    *["\n"] * 12,
    "\ny = ",
    "\ndef f(a) = ",
    "(",
    ")",
]
BASE = """
input u[Nm]
scalar K
map M
step 0.1
def f(a, b) = a * b + prev(a, 0)
_h = M(u, y) + K
y[-] = PT1(_h, 0.5) + f(u, delay(z, 3))
z = integrator(u - prev(y, 0), 1, -5, 5)
output z
"""


def read(text: str, known: list[str] | None = None) -> None:
    try:
        model = formula(text, "fuzz.kf", known)
    except InputError as error:
        assert error.findings
        assert all(finding.place.startswith("fuzz.kf") and finding.what for finding in error.findings)
    else:
        assert formula(to_text(model.graph)).graph == model.graph


@settings(max_examples=600, deadline=None)
@given(st.lists(st.sampled_from(WORDS), max_size=60).map(" ".join), st.sampled_from([None, [], ["a", "K", "M"]]))
def test_a_soup_of_words_is_read_or_answered(text, known):
    read(text, known)


@settings(max_examples=300, deadline=None)
@given(st.text(st.one_of(st.sampled_from(string.printable), st.characters()), max_size=80))
def test_any_text_is_read_or_answered(text):
    read(text)
    read("y = " + text)
    for way in (lambda: expression(text, "fuzz.kf"), lambda: extend(formula(BASE), {"new": text}, "fuzz.kf")):
        try:
            way()
        except InputError as error:
            assert error.findings


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_a_text_with_mistakes_is_read_or_answered(data):
    text = BASE
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        end = at + data.draw(st.integers(0, 6))
        text = text[:at] + data.draw(st.sampled_from(["", *WORDS])) + text[end:]
    read(text)


@settings(max_examples=100, deadline=None)
@given(graphs(), st.data())
def test_a_printed_text_with_a_mistake_is_read_or_answered(graph, data):
    text = to_text(graph)
    at = data.draw(st.integers(0, len(text)))
    read(text[:at] + data.draw(st.sampled_from(WORDS)) + text[at + data.draw(st.integers(0, 3)) :])
