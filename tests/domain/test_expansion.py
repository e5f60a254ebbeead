import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.rbf import Expansion, Hinge
from kennfeld.native.rbf_code import KERNELS
from tests.draws import few_or_many


def random_expansion(seed, inputs=2, centres=5, kernel="gaussian"):
    rng = np.random.default_rng(seed)
    return Expansion(
        rng.normal(),
        rng.normal(size=inputs),
        rng.normal(size=centres),
        rng.normal(size=(centres, inputs)),
        rng.uniform(0.5, 2.0, (centres, inputs)),
        kernel,
    )


def matern52(point, centre, width):
    """The kernel as scikit-learn's documentation writes it, for nu = 5/2."""
    r = np.sqrt(np.sum(((point - centre) / width) ** 2))
    return (1 + np.sqrt(5) * r + 5 / 3 * r**2) * np.exp(-np.sqrt(5) * r)


@few_or_many(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(0, 6), few=20, many=100)
def test_the_value_is_the_sum_that_the_docstring_writes(seed, inputs, centres):
    model = random_expansion(seed, inputs, centres)
    for x in np.random.default_rng(seed).normal(size=(3, inputs)):
        bells = [np.exp(-0.5 * np.sum(((x - c) / w) ** 2)) for c, w in zip(model.centres, model.widths, strict=True)]
        expected = model.offset + model.slopes @ x + np.dot(model.weights, bells)
        assert model(x) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_the_matern_kernel_is_the_one_of_the_textbook():
    model = random_expansion(3, 3, 6, "matern52")
    x = np.random.default_rng(4).normal(size=3)
    bells = [matern52(x, centre, width) for centre, width in zip(model.centres, model.widths, strict=True)]
    assert model(x) == pytest.approx(model.offset + model.slopes @ x + model.weights @ bells, rel=1e-12)


def test_an_unknown_kernel_is_refused():
    with pytest.raises(ArgumentError, match="kernel='cosine' of an expansion must be gaussian or matern52"):
        random_expansion(0, kernel="cosine")


@few_or_many(
    st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(0, 6), st.sampled_from(KERNELS), few=20, many=100
)
def test_the_gradient_agrees_with_differences(seed, inputs, centres, kernel):
    model = random_expansion(seed, inputs, centres, kernel)
    x = np.random.default_rng(seed).normal(size=(4, inputs))
    for d in range(inputs):
        step = 1e-6 * np.eye(inputs)[d]
        difference = (model(x + step) - model(x - step)) / 2e-6
        np.testing.assert_allclose(model.gradient(x)[..., d], difference, rtol=1e-6, atol=1e-7)


HINGES = (Hinge(0, 0.2, 3.0), Hinge(1, -0.1, -1.5), Hinge(0, 0.9, 1.0))


def hinged(hinges=HINGES):
    e = random_expansion(0)
    return Expansion(e.offset, e.slopes, e.weights, e.centres, e.widths, e.kernel, hinges)


def test_hinges_are_added_and_change_the_slope_from_their_kink_on():
    x = np.random.default_rng(0).normal(size=(50, 2))
    added = 3 * np.maximum(x[:, 0] - 0.2, 0) - 1.5 * np.maximum(x[:, 1] + 0.1, 0) + np.maximum(x[:, 0] - 0.9, 0)
    np.testing.assert_allclose(hinged()(x) - random_expansion(0)(x), added, atol=1e-12)
    step = 1e-6 * np.eye(2)
    differences = [(hinged()(x + d) - hinged()(x - d)) / 2e-6 for d in step]
    np.testing.assert_allclose(hinged().gradient(x), np.transpose(differences), rtol=1e-5, atol=1e-6)
    at = np.array([0.2, -0.1])
    np.testing.assert_allclose(hinged().gradient(at) - random_expansion(0).gradient(at), [3.0, -1.5])


def test_hinges_belong_to_what_makes_expansions_equal():
    assert hinged() == hinged() != random_expansion(0) == hinged().without_hinges
    assert hash(hinged()) != hash(hinged(HINGES[:1]))


@pytest.mark.parametrize(
    ("hinges", "message"),
    [
        ([(2, 0.0, 1.0)], "along inputs 0 to 1, counted from 0, not 2"),
        ([(-1, 0.0, 1.0)], "not -1"),
        ([(0.5, 0.0, 1.0)], "not 0.5"),
        ([(0, np.nan, 1.0)], "finite numbers"),
        ([(0, 1.0)], "rows of input, position and height"),
        ([1.0], "rows of input, position and height"),
        ([("x", 0.0, 1.0)], "rows of input, position and height"),
        ([(0, "1.0", 1.0)], "rows of input, position and height"),
        ([(True, 0.0, 1.0)], "rows of input, position and height"),
    ],
)
def test_hinges_that_cannot_be_used_are_named(hinges, message):
    with pytest.raises(ArgumentError, match=message):
        hinged(hinges)


def test_points_keep_their_shape():
    model = random_expansion(0, inputs=3)
    x = np.random.default_rng(1).normal(size=(4, 5, 3))
    assert model(x).shape == (4, 5)
    assert model.gradient(x).shape == (4, 5, 3)
    assert model(x[0, 0]).shape == ()
    assert model(np.empty((0, 3))).shape == (0,)


def test_points_in_blocks_equal_all_points_at_once(monkeypatch):
    model = random_expansion(0)
    x = np.random.default_rng(1).normal(size=(50, 2))
    whole, slopes = model(x), model.gradient(x)
    monkeypatch.setattr("kennfeld.domain.rbf.BELLS_PER_BLOCK", 12)
    np.testing.assert_allclose(model(x), whole, rtol=1e-14)
    np.testing.assert_allclose(model.gradient(x), slopes, rtol=1e-13, atol=1e-15)


def test_far_away_only_the_plane_is_left():
    model = Expansion(1.0, [2.0], [3.0], [[0.0]], [[1e-300]])
    assert model(np.array([1e300])) == 2e300
    assert model.gradient(np.array([1e300])) == 2.0


def test_a_missing_value_gives_a_missing_value():
    assert np.isnan(random_expansion(0)(np.array([np.nan, 0.0])))


def test_equal_numbers_make_equal_expansions():
    first, second = random_expansion(3), random_expansion(3)
    assert first == second
    assert hash(first) == hash(second)
    assert first != random_expansion(4)
    assert first != "an expansion"


def test_nobody_can_write_to_its_numbers():
    weights = np.ones(1)
    model = Expansion(0.0, [0.0], weights, [[0.0]], [[1.0]])
    weights[0] = 5.0
    assert model.weights[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        model.weights[0] = 2.0


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((np.nan, [0.0], [1.0], [[0.0]], [[1.0]]), "offset=nan"),
        ((0.0, [], [], np.empty((0, 0)), np.empty((0, 0))), "slopes of an expansion must be one number per input"),
        ((0.0, [0.0], [[1.0]], [[0.0]], [[1.0]]), "weights of an expansion must be one number per centre"),
        ((0.0, [0.0], [np.inf], [[0.0]], [[1.0]]), r"weights\[0\]=inf"),
        ((0.0, [0.0], [1.0], [0.0], [[1.0]]), r"centres of an expansion have shape \(1,\)"),
        ((0.0, [0.0], [1.0], [[0.0]], [[1.0, 1.0]]), r"widths of an expansion have shape \(1, 2\)"),
        ((0.0, [0.0], [1.0], [[0.0]], [[0.0]]), "must be > 0, the smallest is 0"),
        ((0.0, [0.0], [1.0], [[0.0], [0.0, 1.0]], [[1.0]]), "centres of an expansion must be numbers"),
    ],
)
def test_numbers_that_contradict_each_other_are_named(numbers, message):
    with pytest.raises(ArgumentError, match=message):
        Expansion(*numbers)


def test_points_of_the_wrong_width_are_named():
    with pytest.raises(ArgumentError, match=r"x must have the shape \[\.\.\., 2\], got \(3,\)"):
        random_expansion(0)(np.zeros(3))


def test_slopes_are_distinguished_from_hinges_also_without_centres():
    planes = Expansion(0.0, [1.0, 0.0, 2.0, 3.0], [], np.zeros((0, 4)), np.zeros((0, 4)))
    hinge = Expansion(0.0, [1.0], [], np.zeros((0, 1)), np.zeros((0, 1)), hinges=[(0, 2.0, 3.0)])
    assert planes != hinge
    assert hinge == Expansion(0.0, [1.0], [], np.zeros((0, 1)), np.zeros((0, 1)), hinges=[(0, 2.0, 3.0)])
