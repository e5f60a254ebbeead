"""Tests of many cases: few of them by default, and all where slow tests run."""

from collections.abc import Callable, Collection, Iterable
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis.strategies import SearchStrategy


def few_or_many(
    *strategies: SearchStrategy[Any], few: int, many: int, **named: SearchStrategy[Any]
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Turn a function of drawn values into a test with few draws and a slow one with many.

    Args:
        strategies: for its last arguments.
        few: number of draws of the test.
        many: number of draws of the slow test.
        named: strategies for arguments of these names. The other arguments are those of pytest.
    """

    def decorate(check: Callable[..., None]) -> Callable[..., None]:
        arguments = [name for name in signature(check).parameters if name not in named]
        drawn = arguments[len(arguments) - len(strategies) :]

        @pytest.mark.parametrize(
            "draws", [pytest.param(few, id="few"), pytest.param(many, id="many", marks=pytest.mark.slow)]
        )
        @wraps(check)
        def test(draws: int, **others: Any) -> None:
            limits = settings(deadline=None, max_examples=draws, suppress_health_check=list(HealthCheck))
            limits(given(**dict(zip(drawn, strategies, strict=True)), **named)(check))(**others)

        names = ["draws", *arguments[: len(arguments) - len(strategies)]]
        test.__signature__ = Signature([Parameter(name, Parameter.KEYWORD_ONLY) for name in names])
        return test

    return decorate


def mostly_slow(cases: Iterable[Any], unmarked: int | Collection[Any]) -> list[Any]:
    """Cases of a test, all but the first few, or but those that are named, marked as slow."""
    cases = list(cases)
    kept = cases[:unmarked] if isinstance(unmarked, int) else unmarked
    return [case if case in kept else pytest.param(case, marks=pytest.mark.slow) for case in cases]
