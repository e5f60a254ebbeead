"""Statistics of parts are those of the whole."""

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld.base.sample_statistics import Moments, Ranks, gather
from tests.draws import few_or_many

NUMBERS = arrays(np.float64, st.integers(1, 60), elements=st.floats(-1e6, 1e6))
CUTS = st.lists(st.integers(0, 60), max_size=4).map(sorted)
SHARES = (0.0, 0.001, 0.25, 0.5, 0.95, 1.0)


def quantiles(parts):
    search = gather(Ranks.of, parts).search(SHARES)
    quantile_search = gather(search.part, parts)
    return [quantile_search.quantile(share) for share in SHARES]


@few_or_many(NUMBERS, CUTS, few=20, many=100)
def test_quantiles_of_parts_are_exact(values, cuts):
    np.testing.assert_array_equal(quantiles(np.split(values, cuts)), np.quantile(values, SHARES))


@few_or_many(
    st.lists(st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, np.inf, -np.inf]), min_size=1, max_size=30),
    CUTS,
    few=20,
    many=100,
)
def test_quantiles_of_few_different_numbers_are_exact(values, cuts):
    with np.errstate(invalid="ignore"):
        expected = np.quantile(values, SHARES)
    np.testing.assert_array_equal(quantiles(np.split(np.array(values), cuts)), expected)


@few_or_many(NUMBERS, CUTS, few=20, many=100)
def test_quantiles_of_too_many_numbers_are_counted(values, cuts):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kennfeld.base.sample_statistics.MOST_NEAR", 0)
        ranks = np.sort(values)[np.round(np.array(SHARES) * (values.size - 1)).astype(int)]
        counted = np.array(quantiles(np.split(values, cuts)))
        np.testing.assert_allclose(
            counted, np.quantile(values, SHARES), rtol=2e-5, atol=2e-5 * np.abs(values).max() + 1e-300
        )
        assert (counted[0], counted[-1]) == pytest.approx((ranks[0], ranks[-1]), rel=2e-5, abs=1e-300)
        search = Ranks.of(values).search(SHARES)
        search.merge(search.part(values))
        assert not any(part.size for part in search._near)


@pytest.mark.parametrize("value", [0.0, -0.0, 3.0, -0.75, np.inf, -np.inf])
def test_round_numbers_are_exact_even_if_counted(value, monkeypatch):
    monkeypatch.setattr("kennfeld.base.sample_statistics.MOST_NEAR", 0)
    search = Ranks.of(np.full(9, value)).search([0.5])
    search.merge(search.part(np.full(9, value)))
    assert next(iter(search._numbers([4]))) == value


def test_unknown_numbers_have_no_rank():
    known = np.random.default_rng(0).normal(size=100)
    values = np.concatenate([known, np.full(7, np.nan)])
    assert quantiles([values[:50], values[50:]]) == np.quantile(known, SHARES).tolist()
    assert np.isnan(quantiles([np.full(3, np.nan)])).all()


@few_or_many(NUMBERS, few=20, many=100)
def test_ranks_of_numbers_give_those_of_their_sizes(values):
    search = Ranks.of(values).sizes.search(SHARES)
    search.merge(search.part(np.abs(values)))
    np.testing.assert_array_equal([search.quantile(s) for s in SHARES], np.quantile(np.abs(values), SHARES))


def test_only_numbers_near_a_quantile_are_kept():
    values = np.random.default_rng(0).normal(size=100_000)
    search = Ranks.of(values).search([0.5, 0.95])
    search.merge(search.part(values))
    assert sum(part.size for part in search._near) < 0.1 * values.size


@few_or_many(NUMBERS, CUTS, few=20, many=100)
def test_moments_of_parts_are_those_of_the_whole(values, cuts):
    moments = gather(Moments.of, np.split(values, cuts))
    assert moments.count == values.size
    assert moments.mean == pytest.approx(values.mean(), rel=1e-9, abs=1e-9)
    scale = max(np.abs(values).max(), 1e-9)
    assert moments.deviation == pytest.approx(values.std(), rel=1e-6, abs=1e-7 * scale)


@few_or_many(st.floats(-1e6, 1e6), CUTS, few=20, many=100)
def test_equal_numbers_have_no_spread(value, cuts):
    moments = gather(Moments.of, np.split(np.full(50, value), cuts))
    assert (moments.mean, moments.squares) == (value, 0.0)
