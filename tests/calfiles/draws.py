"""How many cases Hypothesis draws: few always, many if slow tests are asked for."""

import pytest
from hypothesis import HealthCheck, settings


def few_or_many(few, many):
    """Give a test `drawn`, the settings under which it checks what Hypothesis draws."""
    few_draws, many_draws = (
        settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck)) for count in (few, many)
    )
    cases = [pytest.param(few_draws, id="few"), pytest.param(many_draws, id="many", marks=pytest.mark.slow)]
    return pytest.mark.parametrize("drawn", cases)
