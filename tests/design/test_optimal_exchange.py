from itertools import combinations, combinations_with_replacement, product

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.design.optimal_exchange import exchange
from kennfeld.design.regression_models import polynomial_rows, rbf_rows


def grid(levels, factors):
    return np.array(list(product(levels, repeat=factors)), dtype=float)


@pytest.mark.parametrize(
    ("points", "model", "count", "determinant"),
    [
        # saturated and orthogonal designs: the columns of a Hadamard matrix, det X'X = n^p
        pytest.param(grid([-1, 1], 3), "interaction", 8, 8.0**7, id="factorial of three"),
        pytest.param(grid([-1, 1], 7), "linear", 8, 8.0**8, id="fraction of seven"),
        pytest.param(grid([-1, 1], 11), "linear", 12, 12.0**12, id="Plackett and Burman 1946"),
        # one factor: equal weight at -1, 0 and 1 (K. Smith, Biometrika 12, 1918)
        pytest.param(np.linspace(-1, 1, 21)[:, None], "quadratic", 6, 4 * 2.0**3, id="parabola"),
        # two factors, nine points: the factorial of three levels (G. Box, N. Draper, Biometrika 58, 1971)
        pytest.param(grid([-1, 0, 1], 2), "quadratic", 9, 5184.0, id="two factors"),
    ],
)
def test_published_d_optimal_designs_are_found(points, model, count, determinant):
    optimal = exchange(polynomial_rows(points, model), count)
    assert np.exp(optimal.log_det) == pytest.approx(determinant, rel=1e-9)


@pytest.mark.parametrize("criterion", ["D", "I"])
def test_no_single_exchange_improves_a_design(criterion):
    points = np.random.default_rng(0).uniform(-1, 1, (40, 2))
    rows = polynomial_rows(points, "quadratic")
    optimal = exchange(rows, 9, criterion)

    def value(chosen):
        moment = rows[chosen].T @ rows[chosen]
        if criterion == "D":
            return -np.linalg.slogdet(moment)[1]
        return np.einsum("ij,jk,ik->i", rows, np.linalg.inv(moment), rows).mean()

    best = value(list(optimal.chosen))
    assert best == pytest.approx(-optimal.log_det if criterion == "D" else optimal.variance)
    for at, other in product(range(9), range(40)):
        chosen = list(optimal.chosen)
        chosen[at] = other
        assert value(chosen) >= best * (1 - 1e-6 * np.sign(best))


@pytest.mark.parametrize("repeats", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_of_few_candidates_the_best_design_is_found(seed, repeats):
    random = np.random.default_rng(seed)
    rows = np.column_stack([np.ones(8), random.normal(size=(8, 3))])
    choices = (combinations_with_replacement if repeats else combinations)(range(8), 5)
    products = [rows[list(chosen)].T @ rows[list(chosen)] for chosen in choices]
    regular = [each for each in products if np.linalg.det(each) > 1e-9]
    best = max(np.linalg.slogdet(each)[1] for each in regular)
    least = min(np.trace(np.linalg.solve(each, rows.T @ rows / 8)) for each in regular)
    assert exchange(rows, 5, "D", repeats=repeats).log_det == pytest.approx(best, rel=1e-9)
    assert exchange(rows, 5, "I", repeats=repeats).variance == pytest.approx(least, rel=1e-9)


def test_without_repeats_each_candidate_occurs_once():
    rows = polynomial_rows(grid([-1, 0, 1], 2), "linear")
    assert len(set(exchange(rows, 8, repeats=False).chosen)) == 8
    assert len(set(exchange(rows, 8).chosen)) < 8


def test_bells_of_an_rbf_are_determined_where_they_are():
    points = grid(np.linspace(-1, 1, 9), 2)
    rows = rbf_rows(points, 6)
    assert rows.shape == (81, 9)
    i_optimal, d_optimal = (exchange(rows, 20, criterion) for criterion in ("I", "D"))
    assert i_optimal.variance <= d_optimal.variance
    assert d_optimal.log_det >= i_optimal.log_det


@pytest.mark.parametrize(
    ("rows", "count", "message"),
    [
        (polynomial_rows(grid([-1, 0, 1], 2), "quadratic"), 5, "5 points cannot determine the 6 coefficients"),
        (polynomial_rows(grid([-1, 1], 2), "quadratic"), 8, "candidates determine 4 of the 6 coefficients"),
        (polynomial_rows(grid([-1, 1], 3), "quadratic"), 12, "candidates determine 7 of the 10 coefficients"),
    ],
)
def test_what_cannot_determine_a_model_is_an_error(rows, count, message):
    with pytest.raises(kf.InputError, match=message):
        exchange(rows, count)
