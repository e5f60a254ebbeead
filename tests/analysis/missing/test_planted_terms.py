"""Some cases of the benchmark: planted terms are found at their place, and none where none is missing."""

from itertools import islice

import numpy as np
import pytest
from benchmarks.missing_terms import cases, judge

pytestmark = pytest.mark.slow
COUNT = 12  # two of each function with a term, and two without


def outcomes():
    return [judge(case) for case in islice(cases(), COUNT)]


def test_planted_terms_are_found_at_their_place_and_nothing_else():
    judged = outcomes()
    planted = [outcome for outcome in judged if outcome.case.channel]
    assert len(planted) == COUNT // 2
    assert [str(outcome) for outcome in planted if not (outcome.channel and outcome.place)] == []
    assert [str(outcome) for outcome in judged if outcome.false] == []
    # an ignition optimum that is off by three deviations of the noise is far
    close = [outcome.closeness for outcome in planted if not outcome.case.name.startswith("torque ignOpt")]
    assert np.nanmax(np.abs(close)) < 0.03
