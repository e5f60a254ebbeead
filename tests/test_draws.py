"""Random cases are the same in every run, or new ones on request."""

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.draws import few_or_many


def drawn(profile):
    """Return what Hypothesis draws with a profile of `conftest.py`."""
    values = []

    @settings(settings.get_profile(profile), max_examples=20, database=None)
    @given(st.integers())
    def check(value):
        values.append(value)

    check()
    return values


def test_cases_are_the_same_in_every_run():
    assert drawn("same") == drawn("same")


def test_new_cases_are_explored_on_request():
    assert drawn("explore") != drawn("explore")


def test_the_same_cases_are_the_default(request):
    assert settings.default.derandomize == (request.config.getoption("hypothesis_profile") != "explore")


def test_few_or_many_cases_follow_the_profile():
    values = []

    @few_or_many(st.integers(), few=20, many=50)
    def check(value):
        values.append(value)

    check(draws=20)
    check(draws=20)
    assert (values[:20] == values[20:]) == settings.default.derandomize
