from importlib import import_module
from itertools import combinations

import numpy as np
import pytest

from kennfeld.design.coverage import WeightedCoverage


def random_coverage(seed=0, draws=2, candidates=9, values=12):
    random = np.random.default_rng(seed)
    information = random.exponential(1.0, (draws, candidates, values)) * (
        random.random((draws, candidates, values)) < 0.3
    )
    return WeightedCoverage(
        random.uniform(0.1, 0.5, (draws, values)), information, random.exponential(1.0, (draws, values))
    )


@pytest.mark.parametrize("seed", range(5))
def test_of_few_candidates_the_best_choice_is_found(seed):
    cover = random_coverage(seed)
    best = min(cover.of(list(chosen)) for chosen in combinations(range(9), 3))
    assert cover.of(cover.choose(3)) == pytest.approx(best, rel=1e-12)
    assert cover.drop(3, exchange=True)[-1][1] == pytest.approx(best, rel=1e-12)


def test_where_the_first_one_misleads_the_best_choice_is_found():
    # the first candidate adds most, but the other two complement each other
    information = np.array([[[9.0, 9.0], [40.0, 0.0], [0.0, 40.0]]])
    assert sorted(WeightedCoverage(np.ones((1, 2)), information, np.ones((1, 2))).choose(2)) == [1, 2]


def test_of_many_candidates_several_starts_end_nearer_to_the_best(monkeypatch):
    covers = [random_coverage(seed, candidates=30) for seed in range(6)]
    several = [cover.of(cover.choose(8)) for cover in covers]
    monkeypatch.setattr(import_module("kennfeld.design.coverage"), "MOST_STEPS", 0)
    one = [cover.of(cover.choose(8)) for cover in covers]
    assert all(np.array(several) <= np.array(one) * (1 + 1e-12))
    assert sum(several) < sum(one)


def test_the_first_of_a_choice_adds_most():
    cover = random_coverage()
    chosen = cover.choose(4)
    alone = [cover.of([number]) for number in chosen]
    assert alone[0] == min(alone)
    assert len(set(chosen)) == 4


def test_no_more_is_chosen_than_there_is():
    assert sorted(random_coverage().choose(20)) == list(range(9))
    assert sorted(random_coverage().choose(20, np.array([1, 2]))) == [0, 3, 4, 5, 6, 7, 8]


def test_use_decides_between_candidates_of_equal_information():
    information = np.array([[[5.0, 0.0], [0.0, 5.0]]])
    for use in (0, 1):
        weights = np.array([[1.0, 1.0]])
        weights[0, use] = 2.0
        assert WeightedCoverage(np.ones((1, 2)), information, weights).choose(1) == [use]


def test_what_is_dropped_first_is_a_copy_of_others():
    information = np.array([[[5.0, 0.0], [5.0, 0.1], [0.0, 5.0], [5.0, 0.0]]])
    cover = WeightedCoverage(np.full((1, 2), 1e-3), information, np.ones((1, 2)))
    dropped = cover.drop(2)
    assert 2 not in [number for number, _ in dropped]
    assert [variance for _, variance in dropped] == sorted(variance for _, variance in dropped)
    kept = [number for number in range(4) if number not in [gone for gone, _ in dropped]]
    assert dropped[-1][1] == pytest.approx(cover.of(kept))


def test_gains_name_what_only_one_candidate_tells():
    information = np.array([[[5.0, 0.0, 1.0], [0.0, 5.0, 1.0]]])
    gains = WeightedCoverage(np.full((1, 3), 0.1), information, np.ones((1, 3))).gains([0, 1])
    assert gains[0].argmax() == 0
    assert gains[1].argmax() == 1
    assert gains[0][1] == 0


def test_a_search_that_is_stopped_keeps_what_it_has_chosen():
    cover = random_coverage()
    first = cover.choose(5, stop=lambda chosen: True)
    assert first == cover.choose(1)
    assert len(cover.choose(5, stop=lambda chosen: len(chosen) >= 3)) == 3
    dropped = cover.drop(2)
    assert cover.drop(2, exchange=True, stop=lambda gone: len(gone) >= 4) == dropped[:4]
