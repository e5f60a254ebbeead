import gzip
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.rbf import Expansion
from kennfeld.native.rbf_code import KERNELS
from kennfeld.surrogate.exact_gp import Exact, exact_likelihood
from kennfeld.surrogate.gaussian_process import gaussian_process
from kennfeld.surrogate.gp_kernel import Plane, greedy, k_means
from kennfeld.surrogate.sparse_gp import Sparse, sparse_bound
from kennfeld.surrogate.training_points import TrainingPoints
from kennfeld.surrogate.uncertainty import Deviation


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


ENGINE = Path(__file__).resolve().parents[3] / "shared/data/engine_transient"
AT = np.array([0.3, -0.2, 0.5, -3.0])


def repeated_points():
    x, y = scaled_points()
    rng = np.random.default_rng(1)
    rows = np.concatenate([np.arange(50), rng.integers(50, size=12)])
    return x[rows], y[rows] + 0.1 * rng.normal(size=rows.size)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("kind", ["exact", "sparse"])
def test_the_gradient_of_the_likelihood_agrees_with_differences(kind, kernel):
    merged = TrainingPoints.of(*repeated_points())
    plane, z = Plane.over(merged.x), merged.x[:12] + 0.1
    weighted = Plane.over(merged.x, merged.weights)

    def likelihood(at):
        if kind == "exact":
            return exact_likelihood(at, merged, plane, kernel)
        return sparse_bound(at, merged, z, weighted, kernel)

    differences = [(likelihood(AT + h)[0] - likelihood(AT - h)[0]) / 2e-5 for h in 1e-5 * np.eye(4)]
    np.testing.assert_allclose(likelihood(AT)[1], differences, rtol=1e-5)


def test_the_exact_likelihood_is_that_of_a_plane_with_an_ever_wider_prior():
    x, y = scaled_points(20)
    lengths, noise = np.exp(AT[:3]), np.exp(AT[3])
    distance = np.sum(((x[:, None] - x) / lengths) ** 2, axis=2)
    plane = Plane.over(x)
    merged = TrainingPoints.of(x, y)
    process = Exact.at(merged, lengths, noise)
    wide = 1e6
    covariance = np.exp(-0.5 * distance) + noise * np.eye(20) + wide * plane.basis @ plane.basis.T
    misfit = y @ np.linalg.solve(covariance, y)
    count = 20 - plane.rank
    logarithm = np.linalg.slogdet(covariance)[1] - plane.rank * np.log(wide)
    assert process.system.variance == pytest.approx(misfit / count, rel=1e-4)
    expected = -0.5 * (count * np.log(misfit / count) + logarithm)
    assert exact_likelihood(AT, merged, plane, "gaussian")[0] == pytest.approx(expected, rel=1e-4)


def unmerged(x, y):
    one = np.ones(len(y))
    return TrainingPoints(x, y, one, 0 * one, 0 * one, np.arange(len(y)))


@pytest.mark.parametrize("kernel", KERNELS)
def test_merged_rows_have_the_likelihood_of_all_rows(kernel):
    x, y = repeated_points()
    merged, rows = TrainingPoints.of(x, y), unmerged(x, y)
    z = merged.x[:12]
    planes = Plane.over(merged.x), Plane.over(merged.x, merged.weights), Plane.over(x)
    pairs = [
        (
            exact_likelihood(at, merged, planes[0], kernel)[0] - exact_likelihood(at, rows, planes[2], kernel)[0],
            sparse_bound(at, merged, z, planes[1], kernel)[0] - sparse_bound(at, rows, z, planes[2], kernel)[0],
        )
        for at in (AT, AT + 0.4, AT - 0.2)
    ]
    np.testing.assert_allclose(pairs, [pairs[0]] * 3, atol=1e-8)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("kind", ["exact", "sparse"])
def test_leaving_out_a_block_in_closed_form_is_leaving_it_out(kind, kernel):
    merged = TrainingPoints.of(*repeated_points())
    lengths, noise, block = np.exp(AT[:3]), float(np.exp(AT[3])), np.array([3, 17, 40])

    def process(some):
        if kind == "exact":
            return Exact.at(some, lengths, noise, kernel)
        return Sparse.at(some, merged.x[:12], lengths, noise, kernel, refine=False)

    offset, slopes, weights, centres = process(merged.part(np.setdiff1d(np.arange(50), block))).terms()
    model = Expansion(offset, slopes, weights, centres, np.broadcast_to(lengths, centres.shape), kernel)
    residual = process(merged).left_out([block, np.array([0])])
    np.testing.assert_allclose(residual[block], merged.y[block] - model(merged.x[block]), rtol=1e-6, atol=1e-8)


def test_with_every_point_an_inducing_input_sparse_is_exact():
    x, y = scaled_points(30)
    lengths, noise = np.exp(AT[:3]), float(np.exp(AT[3]))
    merged = TrainingPoints.of(x, y)
    exact, sparse = Exact.at(merged, lengths, noise), Sparse.at(merged, x, lengths, noise, refine=False)
    for own, other in zip(sparse.terms()[:2], exact.terms()[:2], strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-4)
    np.testing.assert_allclose(sparse.left_out(), exact.left_out(), rtol=1e-4, atol=1e-6)
    bound = sparse_bound(AT, merged, x, Plane.over(x), "gaussian")[0]
    likelihood = exact_likelihood(AT, merged, Plane.over(x), "gaussian")[0]
    assert bound == pytest.approx(likelihood, abs=1e-3)
    assert bound <= likelihood + 1e-6


def test_leaving_one_out_in_closed_form_is_leaving_it_out():
    x, y = scaled_points(25)
    lengths, noise = np.exp(AT[:3]), float(np.exp(AT[3]))
    residual = Exact.at(TrainingPoints.of(x, y), lengths, noise).left_out()
    for i in (0, 11, 24):
        kept = np.arange(25) != i
        without = Exact.at(TrainingPoints.of(x[kept], y[kept]), lengths, noise)
        offset, slopes, weights, centres = without.terms()
        bells = np.exp(-0.5 * np.sum(((x[i] - centres) / lengths) ** 2, axis=1))
        assert residual[i] == pytest.approx(y[i] - offset - slopes @ x[i] - weights @ bells, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "count"), [("exact", 150), pytest.param("sparse", 250, marks=pytest.mark.slow)])
def test_it_finds_function_noise_and_relevance(method, count):
    x, y = points(count, noise=2.0)
    process = gaussian_process(x, y, method=method, centres=80 if method == "sparse" else None, starts=1)
    at = np.random.default_rng(5).uniform(0.05, 0.95, size=(200, 3))
    lengths = process.expansion.widths[0]
    assert (process.expansion.size < count) == (method == "sparse")
    assert np.sqrt(np.mean((process.expansion(at) - wavy(at)) ** 2)) < 1.2
    assert lengths[2] > 3 * lengths[:2].max()
    assert 1.6 < rmse(process.left_out) < 2.8


def test_points_far_from_the_data_are_outside():
    x, y = points(120, inputs=2)
    process = gaussian_process(x, y, starts=1)
    far = np.array([[5.0, 5.0], [0.5, -4.0]])
    assert process.validity.outside(far).all()
    assert process.validity.outside(x).mean() < 0.02


@pytest.mark.slow
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


def test_fewer_centres_than_points_are_kept_to():
    x, y = points(150)
    assert gaussian_process(x, y, centres=40, kernel="matern52", starts=1).expansion.size == 40
    exact = gaussian_process(x, y, method="exact", centres=40, kernel="gaussian", starts=1)
    assert exact.expansion.size == 150
    assert exact.remarks == ("centres = 40 is not used: an exact Gaussian process has one per point, 150",)


def drive(count=1500):
    """A recording in which an input is nearly constant and the output has a fast part, as a drive has."""
    t = np.arange(count) / 10
    rng = np.random.default_rng(0)
    speed = np.interp(t, np.arange(0, 160, 4), rng.normal(size=40))
    load = np.interp(t, np.arange(0, 160, 2), rng.normal(size=80)) ** 3
    cutoff = (load < -1.5) * 8.0 + 1e-3 * rng.normal(size=count)
    fast = np.interp(t, np.arange(0, 160, 0.5), rng.normal(size=320))
    return np.column_stack([speed, load, cutoff]), np.tanh(2 * speed) * np.tanh(load) + 0.4 * fast


@pytest.mark.slow
@pytest.mark.skipif(not ENGINE.is_dir(), reason=f"the recordings of an engine are not at {ENGINE}")
def test_a_sparse_process_of_a_real_drive_does_not_collapse_to_the_plane():
    def recording(name):
        with gzip.open(ENGINE / f"gengine1_{name}.csv.gz", "rt", encoding="utf-8") as file:
            table = np.genfromtxt(file, delimiter=",", names=True)[::25]
        inputs = ("speed", "load", "lambda", "ignition", "fuel_cutoff")
        return np.column_stack([table[name] for name in inputs]), table["NOx"]

    parts = [recording(name) for name in ("m10", "m11", "m12", "m30", "m31")]
    x, y = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    process = gaussian_process(x, y, kernel="gaussian", blocks=np.arange(len(y)) * 20 // len(y))
    at, measured = recording("m53")
    assert rmse(process.expansion(at) - measured) < 0.6 * rmse(process.plane(at) - measured)


@pytest.mark.slow
def test_a_sparse_process_of_a_drive_does_not_collapse_to_the_plane():
    x, y = drive(480)
    blocks = np.arange(len(y)) // 24
    process = gaussian_process(x, y, method="sparse", centres=30, kernel="gaussian", starts=1, blocks=blocks)
    assert process.expansion.size > 0
    assert rmse(process.left_out) < 0.9 * rmse(process.plane_left_out)


def test_noise_alone_leaves_the_plane_with_a_remark():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(80, 4))
    process = gaussian_process(x, x[:, 0] + rng.normal(size=80), starts=1)
    assert process.expansion.size == 0
    assert "not better than the plane" in process.remarks[0]
    np.testing.assert_allclose(process.expansion(x), process.plane(x))
    np.testing.assert_array_equal(process.left_out, process.plane_left_out)


def test_the_same_rows_again_change_neither_model_nor_left_out_errors():
    x, y = points(70, inputs=2)
    once, twice = (gaussian_process(np.tile(x, (k, 1)), np.tile(y, k), kernel="gaussian", starts=1) for k in (1, 2))
    assert (once.repeated, twice.repeated) == (0, 70)
    assert rmse(twice.left_out) == pytest.approx(rmse(once.left_out), rel=0.5)
    at = 0.1 + 0.8 * np.random.default_rng(3).uniform(size=(100, 2))
    assert rmse(twice.expansion(at) - wavy(at)) < 1.3 * rmse(once.expansion(at) - wavy(at))


@pytest.mark.parametrize("value", [1e6, -300.0])
def test_an_outlier_is_detected_and_not_used(value):
    x, y = points(100, inputs=2)
    wild = y.copy()
    wild[[17, 60]] = value
    process, clean = (
        gaussian_process(x, wild, starts=1),
        gaussian_process(np.delete(x, [17, 60], 0), np.delete(y, [17, 60]), starts=1),
    )
    np.testing.assert_array_equal(np.flatnonzero(process.outliers), [17, 60])
    assert np.isnan(process.left_out[[17, 60]]).all()
    np.testing.assert_allclose(process.expansion(x), clean.expansion(x), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["auto", "student"])
def test_large_errors_count_less_with_student_noise(noise):
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (150, 2))
    true = np.sin(3 * x[:, 0]) * x[:, 1]
    bad = rng.uniform(size=150) < 0.08
    y = true + 0.05 * rng.normal(size=150) + 0.8 * bad * rng.normal(size=150)
    robust, normal = (gaussian_process(x, y, kernel="gaussian", noise=n, starts=1) for n in (noise, "gaussian"))
    assert rmse(robust.expansion(x) - true) < 0.6 * rmse(normal.expansion(x) - true)
    assert robust.remarks == ("the noise has wide tails; large errors count less",)
    np.testing.assert_array_equal(robust.plane_left_out, normal.plane_left_out)


@pytest.mark.parametrize("wrong", [lambda y: y + 3, lambda y: 0 * y - 1.2], ids=["offset", "stuck"])
def test_wild_values_that_are_alike_do_not_decide_for_normal_noise(wrong):
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (150, 2))
    true = np.sin(3 * x[:, 0]) + x[:, 1] ** 2
    y = true + 0.05 * rng.normal(size=150)
    y = np.where(rng.uniform(size=150) < 0.1, wrong(y), y)
    robust, normal = (
        gaussian_process(x, y, kernel="gaussian", noise=n, starts=1, kinks=False) for n in ("auto", "gaussian")
    )
    assert rmse(robust.expansion(x) - true) < 0.3 * rmse(normal.expansion(x) - true)


def kinked(count, seed=0):
    x = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    true = 2 * np.maximum(x[:, 0] - 0.3, 0) + 1.5 * np.minimum(x[:, 1] + 0.4, 0) + 0.5 * x[:, 2]
    return x, true, true + 0.1 * np.random.default_rng(seed + 1).normal(size=count)


def test_a_kinked_plane_is_chosen_where_it_is_better():
    x, _, y = kinked(200)
    new, true, _ = kinked(1000, seed=9)
    bent, smooth = (gaussian_process(x, y, kernel="gaussian", starts=1, kinks=kinks) for kinks in (True, False))
    assert {hinge.input for hinge in bent.expansion.hinges} == {0, 1}
    assert rmse(bent.expansion(new) - true) < 0.7 * rmse(smooth.expansion(new) - true)
    np.testing.assert_array_equal(bent.plane_left_out, smooth.plane_left_out)
    assert rmse(bent.left_out) < rmse(smooth.left_out)


@pytest.mark.slow
def test_a_smooth_function_gets_no_kinks():
    x, y = points(150, inputs=2)
    bent, smooth = (gaussian_process(x, y, kernel="gaussian", starts=1, kinks=kinks) for kinks in (True, False))
    assert bent.expansion == smooth.expansion


@pytest.mark.slow
def test_normal_noise_is_not_taken_for_wide_tails():
    x, y = points(200, inputs=2)
    surrogates = [gaussian_process(x, y, kernel="gaussian", noise=noise, starts=1) for noise in ("auto", "gaussian")]
    assert surrogates[0].expansion == surrogates[1].expansion


def test_an_outlier_of_an_input_is_detected_and_not_used():
    x, y = points(80, inputs=2)
    x[5, 1] = 1e7
    process = gaussian_process(x, y, kernel="gaussian", starts=1)
    np.testing.assert_array_equal(np.flatnonzero(process.outliers), [5])


@pytest.mark.slow
def test_steep_corners_and_rare_states_are_not_outliers():
    x = np.random.default_rng(0).uniform(0.01, 1, size=(100, 1))
    steep = gaussian_process(x, 1 / x[:, 0], kernel="gaussian", starts=1)
    x, y = drive(260)
    rare = gaussian_process(x, y + 5 * (x[:, 2] > 4), kernel="gaussian", starts=1)
    assert not steep.outliers.any()
    assert not rare.outliers.any()


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_deviation_is_that_of_universal_kriging(kernel):
    x, y = points(40, inputs=2)
    process = gaussian_process(x, y, kernel=kernel, starts=1)
    e, u = process.expansion, process.uncertainty
    at = np.array([[0.4, 0.6], [1.5, -0.5]])
    basis, here = np.column_stack([np.ones(40), x]), np.column_stack([np.ones(2), at])
    alone = [Expansion(0, np.zeros(2), [1.0], [c], e.widths[:1], kernel) for c in e.centres]
    near = np.column_stack([bell(at) for bell in alone])
    inside = np.column_stack([bell(e.centres) for bell in alone]) + np.diag(u.nugget) + 1e6 * basis @ basis.T
    near = near + 1e6 * here @ basis.T
    prior = 1 + 1e6 * np.sum(here**2, axis=1)
    variance = u.signal**2 * (prior - np.sum(near * np.linalg.solve(inside, near.T).T, axis=1)) + u.noise**2
    np.testing.assert_allclose(Deviation(e, u)(at), np.sqrt(variance), rtol=1e-3)


def test_two_deviations_cover_nearly_all_new_measurements():
    x, y = points(250, inputs=2)
    process = gaussian_process(x, y, kernel="gaussian", starts=1)
    new, measured = points(1000, seed=8, inputs=2)
    inside = np.abs(process.expansion(new) - measured) < 2 * Deviation(process.expansion, process.uncertainty)(new)
    assert 0.9 < inside.mean() < 0.98


def test_greedy_centres_leave_little_open():
    x = np.random.default_rng(0).normal(size=(200, 2))
    chosen = greedy(x, 60, np.array([1.0, 1.0]))
    z = x[chosen]
    near = np.exp(-0.5 * np.sum((x[:, None] - z) ** 2, axis=2))
    inner = np.exp(-0.5 * np.sum((z[:, None] - z) ** 2, axis=2)) + 1e-10 * np.eye(len(z))
    variance = 1 - np.sum(near * np.linalg.solve(inner, near.T).T, axis=1)
    assert np.unique(chosen).size == chosen.size
    assert variance.max() < 1e-3


def test_greedy_takes_equal_points_once():
    assert greedy(np.repeat([[0.0], [5.0]], 4, axis=0), 6, np.ones(1)).size == 2


def test_k_means_finds_groups_and_gives_no_more_than_there_are():
    rng = np.random.default_rng(0)
    groups = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    x = np.repeat(groups, 30, axis=0) + 0.1 * rng.normal(size=(90, 2))
    centres = k_means(x, 3, seed=1)
    assert np.abs(centres[:, None] - groups).sum(axis=2).min(axis=0).max() < 0.2
    assert len(k_means(np.repeat(groups, 5, axis=0), 9, seed=0)) == 3
