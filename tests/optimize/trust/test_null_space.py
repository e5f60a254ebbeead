"""The number of undetermined changes, and a remedy after which none is left."""

from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize import Problem, run
from kennfeld.optimize.trust import Trust
from kennfeld.optimize.trust.information_matrix import Spectrum
from kennfeld.project.demo import torque
from tests.draws import mostly_slow

RANDOM = np.random.default_rng(0)
X, Z = RANDOM.uniform(0, 6, 600), RANDOM.uniform(0, 4, 600)
PLAIN = kf.Options(continuation="off")


def problem(text, columns, members, smoothness=0.0, pins=()):
    start = kf.ParameterSet(members)
    model = kf.formula(text, parameters=list(start))
    smooth = dict.fromkeys(start, smoothness)
    data = (kf.Dataset.of("bench", columns),)
    return Problem(model, data, start, (kf.Criterion("m", "y"),), smoothness=smooth, pins=tuple(pins))


def followed(posed, result):
    """The trust in a fit that holds what the remedy asks for, from where the first fit ended."""
    remedy = result.trust.null_space.remedy
    locked = [
        result.parameters[name].changed(locked=result.parameters[name].locked | where)
        for name, where in remedy.locks.items()
    ]
    parameters = result.parameters.with_parameters(*locked)
    return run(replace(posed, parameters=parameters, pins=(*posed.pins, *remedy.pins)), PLAIN)


def curve(name, count, values=1.0):
    return kf.Curve(name, np.arange(float(count)), np.broadcast_to(values, count))


def map_and_curve(smoothness):
    table = kf.Map("A", np.arange(7.0), np.arange(5.0), np.zeros((7, 5)))
    target = np.sin(X) * Z + 0.01 * np.random.default_rng(1).normal(size=X.size)
    return problem("m = A(x, z) + B(x)", {"x": X, "z": Z, "y": target}, [table, curve("B", 7)], smoothness)


@pytest.mark.slow
def test_a_curve_within_a_map_has_an_undetermined_change_for_each_grid_point():
    posed = map_and_curve(0.0)
    result = run(posed, PLAIN)
    space = result.trust.null_space
    assert (space.dimension, space.by_smoothness) == (7, 0)
    assert [(pin.parameter, pin.at) for pin in space.remedy.pins] == [("B", (float(i),)) for i in range(7)]
    assert str(space) == (
        "7 combinations of values of A and B are undetermined. To determine all of them, pin all 7 values of B "
        "to known values, or else to the fitted ones."
    )
    settled = followed(posed, result)
    assert settled.trust.null_space.dimension == 0
    assert settled.trust.null_space.sentence == ""
    assert settled.cost_after == pytest.approx(result.cost_after)  # nothing is lost


def test_changes_that_smoothness_alone_determines_are_counted_separately():
    """Smoothness does not see an offset and a slope in x; it holds the other five."""
    posed = map_and_curve(0.1)
    result = run(posed, PLAIN)
    space = result.trust.null_space
    assert (space.dimension, space.by_smoothness) == (2, 5)
    assert space.sentence == "2 combinations of values of A and B are undetermined. Smoothness alone determines 5 more."
    settled = followed(posed, result).trust.null_space
    assert (settled.dimension, settled.by_smoothness) == (0, 5)
    assert settled.sentence == "Smoothness alone determines 5 combinations of values."
    assert settled.advice == ""


@pytest.mark.parametrize("seed", mostly_slow(range(6), 2))
def test_the_remedy_determines_random_models_of_deficient_rank(seed):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 12))
    rank = int(random.integers(1, count))
    inputs = random.normal(size=(80, rank)) @ random.normal(size=(rank, count)) * 10.0 ** random.integers(-4, 4, count)
    names = [f"x{i}" for i in range(count)]
    columns = dict(zip(names, inputs.T, strict=True)) | {"y": random.normal(size=80)}
    text = "m = " + " + ".join(f"k{i} * x{i}" for i in range(count))
    posed = problem(text, columns, [kf.Scalar(f"k{i}", 0.0) for i in range(count)])
    result = run(posed, PLAIN)
    space = result.trust.null_space
    assert space.dimension == count - rank == len(space.remedy.pins)
    assert followed(posed, result).trust.null_space.dimension == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "pinned"),
    [
        pytest.param("m = A(x) * B(z)", ["B"], marks=pytest.mark.slow),
        ("m = A(x) * B(z) * k", ["B", "k"]),
        pytest.param("m = A(x) + B(z) + k", ["B", "k"], marks=pytest.mark.slow),
    ],
)
def test_the_remedy_of_products_and_sums_pins_their_smallest_parts(text, pinned):
    members = [curve("A", 7), curve("B", 5), *([kf.Scalar("k", 2.0)] if "k" in text else [])]
    posed = problem(text, {"x": X, "z": Z, "y": (3 + np.sin(X)) * (2 + Z)}, members)
    result = run(posed, PLAIN)
    space = result.trust.null_space
    assert space.dimension == len(pinned)
    assert [pin.parameter for pin in space.remedy.pins] == pinned
    settled = followed(posed, result)
    assert settled.trust.null_space.dimension == 0
    assert settled.cost_after <= result.cost_after * (1 + 1e-6)


def test_values_without_data_are_locked():
    posed = problem("m = A(x)", {"x": X / 2, "y": X}, [curve("A", 7)])
    result = run(posed, PLAIN)
    space = result.trust.null_space
    assert space.dimension == 3
    assert space.remedy.locks["A"].tolist() == [False] * 4 + [True] * 3
    assert (
        str(space) == "3 combinations of values of A are undetermined. To determine all of them, lock A at 4, 5 and 6."
    )
    assert followed(posed, result).trust.null_space.dimension == 0


@pytest.mark.slow
def test_the_torque_model_has_its_scale_and_the_efficiencies_beyond_the_data():
    start = torque.start()
    posed = Problem(
        kf.formula(torque.FORMULA, parameters=list(start)),
        (torque.bench(),),
        start,
        (kf.Criterion("TorquePredict", "Torque"),),
    )
    result = run(posed, PLAIN)
    space = result.trust.null_space
    assert space.dimension == 4
    assert np.count_nonzero(space.remedy.locks["CurveEtaDeltaSpark"]) == 3
    assert [pin.parameter for pin in space.remedy.pins] == ["CurveEtaDeltaSpark"]
    assert "4 combinations of values" in space.sentence
    assert "3 of them single values without data" in space.sentence
    assert followed(posed, result).trust.null_space.dimension == 0


def test_changes_against_locks_pins_and_bounds_do_not_count():
    posed = problem("m = a * b * x", {"x": X, "y": X}, [kf.Scalar("a", 2.0), kf.Scalar("b", 3.0)])
    assert run(posed, PLAIN).trust.null_space.dimension == 1
    pinned = replace(posed, pins=(kf.Pin("a", (), 2.0),))
    assert run(pinned, PLAIN).trust.null_space.dimension == 0


def test_a_determined_model_has_no_undetermined_changes():
    posed = problem("m = a + b * x", {"x": X, "y": X}, [kf.Scalar("a", 2.0), kf.Scalar("b", 3.0)])
    space = run(posed, PLAIN).trust.null_space
    assert (space.dimension, space.sentence, space.advice) == (0, "", "")
    assert space.remedy.pins == ()


def test_the_json_of_a_result_contains_the_null_space():
    written = run(map_and_curve(0.0), PLAIN).as_json()["trust"]["null_space"]
    assert written["dimension"] == 7
    assert written["pins"][0]["parameter"] == "B"
    assert written["remedy"].startswith("To determine all of them, pin all 7 values of B")


@pytest.mark.slow
@pytest.mark.parametrize("smoothness", mostly_slow([0.0, 0.1], [0.1]))
def test_the_description_does_not_depend_on_the_basis_of_eigenvectors(monkeypatch, smoothness):
    """Another processor may give any basis of the null space, and any sign of the other eigenvectors."""

    def description():
        result = run(map_and_curve(smoothness), PLAIN)
        return str(result.trust), result.trust.null_space.remedy.pins

    expected = description()
    plain = Spectrum._of.__func__

    def turned(seed):
        def rotated(cls, scale, values, vectors, null):
            random = np.random.default_rng(seed)
            rotation, _ = np.linalg.qr(random.normal(size=(null, null)))
            signs = random.choice([-1.0, 1.0], vectors.shape[1] - null)
            return plain(cls, scale, values, np.hstack([vectors[:, :null] @ rotation, vectors[:, null:] * signs]), null)

        return classmethod(rotated)

    for seed in range(2):
        monkeypatch.setattr(Spectrum, "_of", turned(seed))
        sentences, pins = description()
        assert sentences == expected[0]
        assert [pin.at for pin in pins] == [pin.at for pin in expected[1]]


def test_an_unknown_null_space_is_null_in_json():
    assert Trust().as_json()["null_space"] is None
