"""Tests of random cases: few draws by default, and many where slow tests run."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis.strategies import SearchStrategy


def few_or_many(*strategies: SearchStrategy[Any], few: int, many: int, **options: Any) -> Callable[..., Any]:
    """Turn a function of drawn values into a test with few draws and a slow one with many.

    Args:
        strategies: for its arguments.
        few: number of draws of the test.
        many: number of draws of the slow test.
        options: further settings of Hypothesis.
    """

    def decorate(check: Callable[..., None]) -> Callable[[int], None]:
        @pytest.mark.parametrize(
            "draws", [pytest.param(few, id="few"), pytest.param(many, id="many", marks=pytest.mark.slow)]
        )
        @wraps(check)
        def test(draws: int) -> None:
            settings(deadline=None, max_examples=draws, **options)(given(*strategies)(check))()

        del test.__wrapped__  # pytest would ask for the arguments of `check`
        return test

    return decorate
