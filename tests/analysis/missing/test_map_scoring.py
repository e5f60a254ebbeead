"""Scores of maps are the gains of full refits where the function is linear; few pairs are tried, and the right ones."""

import numpy as np
import pytest

from kennfeld.analysis.missing.candidate_sums import block_sums, family_sums
from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.families import HatAxis, HatPlaces, ProductAxis, map_families, product_families
from kennfeld.analysis.missing.map_scoring import score_maps
from kennfeld.analysis.missing.probes import Nodes, Probes, factor, offset
from kennfeld.analysis.missing.refit import Addition
from kennfeld.analysis.missing.score import Linearisation
from kennfeld.analysis.missing.scoring import score_problem
from kennfeld.domain.parameters import Curve
from kennfeld.optimize.search.multistart import run
from kennfeld.optimize.sums.compiled import CompiledProblem
from tests.analysis.missing.test_score import EXACT, columns, data_cost, fitted, refitted

CURVE = Curve("C", np.linspace(-3, 3, 9), np.zeros(9))
X, Z, W = (
    HatAxis(name, name, points)
    for name, points in [("x", (-2.0, 0.0, 2.0)), ("z", (-2.0, -1.0, 1.0, 2.0)), ("w", (-1.0, 1.0))]
)


def scored(problem, families_of):
    nodes = Nodes.of(problem)
    probes = Probes.of(problem, nodes.names)
    compiled = CompiledProblem(probes.problem)
    names = [name for number in range(len(nodes.names)) for name in (offset(number), factor(number))]
    linear = Linearisation(compiled, compiled.start, block_sums(compiled, compiled.start, {}, 0), names)
    families = families_of(probes, nodes.constant, compiled.values.free)
    return [
        score
        for family in families
        for score in linear.scores(family, family_sums(compiled, [family], compiled.start, {}, 0)[0])
    ]


@pytest.mark.parametrize("timed", [False, True], ids=["without memory", "with memory"])
def test_the_gain_of_a_map_is_that_of_a_full_refit(timed):
    data = columns() | ({"time": 0.1 * np.arange(300)} if timed else {})
    text = "a = C(x)\ny = PT1(a, 0.5) + k" if timed else "a = C(x)\ny = a + k"
    problem, result = fitted(text, {"k": 0.0, "C": CURVE}, data, smoothness=1.0)
    scores = scored(problem, lambda *given: map_families(given[0], [(X, Z), (Z, W)], ["add"], *given[1:]))
    assert len(scores) == 4
    for score in scores[::3]:
        refit = refitted(problem, score.term)
        assert score.gain == pytest.approx(result.cost_after - refit.cost_after, rel=1e-8)
        assert score.predicted == pytest.approx(data_cost(refit), rel=1e-8)


def test_the_gain_of_a_product_is_that_of_a_refit_with_its_column():
    data = columns()
    problem, result = fitted("y = C(x) + k", {"k": 0.0, "C": CURVE}, data, smoothness=1.0)
    [score] = scored(problem, lambda *given: product_families(given[0], [(Z, W)], "add", given[2]))
    place = {
        axis.name: np.interp(data[axis.name], axis.points, np.linspace(-1, 1, len(axis.points))) for axis in (Z, W)
    }
    refit, _ = fitted(
        "y = C(x) + k + q * u",
        {"k": 0.0, "C": CURVE, "q": 0.0},
        data | {"u": place["z"] * place["w"]},
        smoothness={"C": 1.0},
    )
    assert score.gain == pytest.approx(result.cost_after - run(refit, EXACT).cost_after, rel=1e-8)
    columns_of = {"z": np.array([-2.0, 2.0]), "w": np.array([1.0, 1.0])}
    cells, shares = HatPlaces([ProductAxis(Z, W)]).locate(columns_of, np.arange(2))
    assert (cells.tolist(), shares.tolist()) == ([[0], [0]], [[0.0], [1.0]])


def test_lines_that_the_function_can_take_over_are_locked():
    data = columns()
    curve_of_x = fitted("y = C(x) + k", {"k": 0.0, "C": CURVE}, data)[0]
    first = HatAxis("x", "x", tuple(np.linspace(-3, 3, 9)))
    [free] = scored(
        fitted("y = k * w", {"k": 0.0}, data)[0], lambda *given: map_families(given[0], [(X, Z)], ["add"], *given[1:])
    )
    [rows] = scored(curve_of_x, lambda *given: map_families(given[0], [(first, Z)], ["add"], *given[1:]))
    assert free.idle == ()
    locked = Addition.of(curve_of_x, rows).parameter.locked
    # for each x, the value at the middle z
    assert np.argwhere(locked).tolist() == [[k, 2] for k in range(9)]


def test_pairs_are_those_of_the_best_curves_and_of_significant_products():
    rng = np.random.default_rng(2)
    data = {f"c{number}": rng.normal(size=400) for number in range(30)} | {"x": rng.normal(size=400)}
    data["m"] = data["x"] + data["c20"] + 0.5 * data["c21"] + 0.5 * data["c3"] * data["c4"] + 0.2 * rng.normal(size=400)
    problem, _ = fitted("y = k * x", {"k": 1.0}, data)
    channels, nodes = Channels.of(problem), Nodes.of(problem)
    curves = score_problem(problem, channels, nodes, ["add"]).scores
    maps = score_maps(problem, channels, nodes, ["add"], curves)
    pairs = {score.term.channels for score in maps.scores}
    assert ("c20", "c21") in pairs
    assert len(pairs) <= 6
    assert maps.candidates <= 120 + 6
