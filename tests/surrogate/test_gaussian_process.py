import numpy as np
import pytest

from kennfeld.errors import ArgumentError
from kennfeld.surrogate.exact_gp import Exact, exact_likelihood
from kennfeld.surrogate.gaussian_process import gaussian_process
from kennfeld.surrogate.gp_kernel import Plane, greedy, k_means
from kennfeld.surrogate.sparse_gp import Sparse, sparse_bound


def wavy(x):
    return 100 * np.sin(3 * x[:, 0]) * x[:, 1] + 30 * x[:, 0] + 20


def points(count, seed=0, inputs=3, noise=2.0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(size=(count, inputs))
    return x, wavy(x) + noise * rng.normal(size=count)


def scaled_points(count=50):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(count, 3))
    return x, np.sin(x[:, 0]) + x[:, 1] + 0.1 * rng.normal(size=count)


def rmse(residual):
    return np.sqrt(np.mean(residual**2))


AT = np.array([0.3, -0.2, 0.5, -3.0])


@pytest.mark.parametrize("kind", ["exact", "sparse"])
def test_the_gradient_of_the_likelihood_agrees_with_differences(kind):
    x, y = scaled_points()
    plane, z = Plane.over(x), x[:12] + 0.1

    def likelihood(at):
        return exact_likelihood(at, x, y, plane) if kind == "exact" else sparse_bound(at, x, y, z, plane)

    differences = [(likelihood(AT + h)[0] - likelihood(AT - h)[0]) / 2e-5 for h in 1e-5 * np.eye(4)]
    np.testing.assert_allclose(likelihood(AT)[1], differences, rtol=1e-5)


def test_the_exact_likelihood_is_that_of_a_plane_with_an_ever_wider_prior():
    x, y = scaled_points(20)
    lengths, noise = np.exp(AT[:3]), np.exp(AT[3])
    distance = np.sum(((x[:, None] - x) / lengths) ** 2, axis=2)
    plane = Plane.over(x)
    process = Exact.at(x, y, lengths, noise)
    wide = 1e6
    covariance = np.exp(-0.5 * distance) + noise * np.eye(20) + wide * plane.basis @ plane.basis.T
    misfit = y @ np.linalg.solve(covariance, y)
    count = 20 - plane.rank
    logarithm = np.linalg.slogdet(covariance)[1] - plane.rank * np.log(wide)
    assert process.system.variance == pytest.approx(misfit / count, rel=1e-4)
    expected = -0.5 * (count * np.log(misfit / count) + logarithm)
    assert exact_likelihood(AT, x, y, plane)[0] == pytest.approx(expected, rel=1e-4)


def test_with_every_point_an_inducing_input_sparse_is_exact():
    x, y = scaled_points(30)
    lengths, noise = np.exp(AT[:3]), float(np.exp(AT[3]))
    exact, sparse = Exact.at(x, y, lengths, noise), Sparse.at(x, y, x, lengths, noise, refine=False)
    for own, other in zip(sparse.terms()[:2], exact.terms()[:2], strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-4)
    np.testing.assert_allclose(sparse.left_out(), exact.left_out(), rtol=1e-4, atol=1e-6)
    bound, likelihood = sparse_bound(AT, x, y, x, Plane.over(x))[0], exact_likelihood(AT, x, y, Plane.over(x))[0]
    assert bound == pytest.approx(likelihood, abs=1e-3)
    assert bound <= likelihood + 1e-6


def test_leaving_one_out_in_closed_form_is_leaving_it_out():
    x, y = scaled_points(25)
    lengths, noise = np.exp(AT[:3]), float(np.exp(AT[3]))
    residual = Exact.at(x, y, lengths, noise).left_out()
    for i in (0, 11, 24):
        kept = np.arange(25) != i
        without = Exact.at(x[kept], y[kept], lengths, noise)
        offset, slopes, weights, centres = without.terms()
        bells = np.exp(-0.5 * np.sum(((x[i] - centres) / lengths) ** 2, axis=1))
        assert residual[i] == pytest.approx(y[i] - offset - slopes @ x[i] - weights @ bells, rel=1e-6)


@pytest.mark.parametrize(("method", "count"), [("exact", 150), ("sparse", 400)])
def test_it_finds_function_noise_and_relevance(method, count):
    x, y = points(count, noise=2.0)
    process = gaussian_process(x, y, method=method, centres=80, starts=1)
    at = np.random.default_rng(5).uniform(0.05, 0.95, size=(200, 3))
    lengths = process.expansion.widths[0]
    assert (process.expansion.size < count) == (method == "sparse")
    assert np.sqrt(np.mean((process.expansion(at) - wavy(at)) ** 2)) < 1.2
    assert lengths[2] > 3 * lengths[:2].max()
    assert 1.6 < rmse(process.left_out) < 2.8


def test_it_knows_where_it_knows_nothing():
    x, y = points(120, inputs=2)
    process = gaussian_process(x, y, starts=1)
    far = np.array([[5.0, 5.0], [0.5, -4.0]])
    assert process.validity.outside(far).all()
    assert process.validity.outside(x).mean() < 0.02


def test_units_do_not_matter():
    x, y = points(100, inputs=2)
    one = gaussian_process(x, y, starts=1)
    other = gaussian_process(x * [6000, 1e-3] + [900, 0], y * 50 - 7, starts=1)
    at = x[:10] * 0.9
    np.testing.assert_allclose(other.expansion(at * [6000, 1e-3] + [900, 0]), one.expansion(at) * 50 - 7, rtol=1e-4)


def test_inputs_that_move_together_do_no_harm():
    x, y = points(80, inputs=2)
    process = gaussian_process(np.column_stack([x, 2 * x[:, 0] + 1]), y, starts=1)
    assert rmse(process.left_out) < 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda x, y: (x[:4], y[:4]), "4 points are too few for 3 inputs; at least 6 are required"),
        (lambda x, y: (x * [1, 0, 1], y), "air is 0 at every training sample; remove it"),
        (lambda x, y: (np.where(x > 0.99, np.nan, x), y), "has values that are not finite"),
        (lambda x, y: (x, y[1:]), r"x of shape \(300, 3\) and y of shape \(299,\)"),
    ],
)
def test_points_that_cannot_be_used_are_named(change, message):
    with pytest.raises(ArgumentError, match=message):
        gaussian_process(*change(*points(300)), names=("speed", "air", "spark"))


def test_greedy_centres_leave_little_open():
    x = np.random.default_rng(0).normal(size=(200, 2))
    chosen = greedy(x, 60, np.array([1.0, 1.0]))
    z = x[chosen]
    near = np.exp(-0.5 * np.sum((x[:, None] - z) ** 2, axis=2))
    inner = np.exp(-0.5 * np.sum((z[:, None] - z) ** 2, axis=2)) + 1e-10 * np.eye(len(z))
    left = 1 - np.sum(near * np.linalg.solve(inner, near.T).T, axis=1)
    assert np.unique(chosen).size == chosen.size
    assert left.max() < 1e-3


def test_greedy_takes_equal_points_once():
    assert greedy(np.repeat([[0.0], [5.0]], 4, axis=0), 6, np.ones(1)).size == 2


def test_k_means_finds_groups_and_gives_no_more_than_there_are():
    rng = np.random.default_rng(0)
    groups = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    x = np.repeat(groups, 30, axis=0) + 0.1 * rng.normal(size=(90, 2))
    found = k_means(x, 3, seed=1)
    assert np.abs(found[:, None] - groups).sum(axis=2).min(axis=0).max() < 0.2
    assert len(k_means(np.repeat(groups, 5, axis=0), 9, seed=0)) == 3
