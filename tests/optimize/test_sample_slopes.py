"""Slopes at single samples, against finite differences of the simulation."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.dataset import Settling
from kennfeld.optimize import Problem
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.sums.sample_slopes import SampleSlopes
from tests.draws import mostly_slow

RNG = np.random.default_rng(3)
TIME = 0.1 * np.arange(60)
U, V = RNG.uniform(0.0, 3.0, (2, 60))
MODELS = {
    "algebra": "y = M(u, v) * C(u) + a",
    "lag": "y = PT1(M(u, v), a + C(u))",
    "memory": "y = prev(y * C(v), a) / 2 + M(u, v)",
}


def parameters() -> kf.ParameterSet:
    axis = [0.0, 1.0, 2.0, 3.0]
    table = kf.Map("M", axis, axis, RNG.uniform(1.0, 2.0, (4, 4)))
    return kf.ParameterSet([table, kf.Curve("C", axis, [0.2, 0.5, 0.4, 0.7]), kf.Scalar("a", 0.3)])


RECORDED = kf.Dataset.of("drive", {"u": U, "v": V, "z": V}, time=np.where(TIME < 3.0, TIME, TIME + 50.0))
HELD = kf.Dataset.of("points", {"u": U, "v": V, "z": V}, settling=Settling(1.0, 0.3, 0.1))


@pytest.mark.parametrize("text", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("data", [RECORDED, HELD], ids=["recorded", "held"])
@pytest.mark.parametrize("sample", mostly_slow([0, 17, 29, 30, 41], [30]))
def test_slopes_are_those_of_the_simulation(text: str, data: kf.Dataset, sample: int) -> None:
    values = parameters()
    problem = Problem(kf.formula(text, parameters=list(values)), (data,), values, (kf.Criterion("y", "z"),))
    bound = problem.bind(data)
    nodes = NodeSimulator(problem.graph, values, problem.differences)
    at = sample if bound.hold is None else (sample + 1) * bound.hold.samples - 1
    slopes = SampleSlopes(problem, values).at(bound, at, values)
    for name, slope in slopes.items():
        for place in np.ndindex(values[name].values.shape):
            moved = []
            for step in (1e-6, -1e-6):
                changed = values[name].values.copy()
                changed[place] += step
                moved.append(nodes.at(bound, at, values.with_parameters(values[name].with_values(changed)))[0])
            assert slope[0][place] == pytest.approx((moved[0] - moved[1]) / 2e-6, abs=1e-7)


def test_samples_older_than_the_memory_are_neglected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kennfeld.optimize.sums.sample_slopes.MEMORY", 25)
    values = parameters()
    problem = Problem(
        kf.formula("y = PT1(M(u, v), 0.2)", parameters=["M"]), (RECORDED,), values, (kf.Criterion("y", "z"),)
    )
    short = SampleSlopes(problem, values).at(problem.bind(RECORDED), 29, values)
    monkeypatch.undo()
    whole = SampleSlopes(problem, values).at(problem.bind(RECORDED), 29, values)
    assert short["M"] == pytest.approx(whole["M"], abs=1e-4)
    assert not np.array_equal(short["M"], whole["M"])


@pytest.mark.parametrize("data", [RECORDED, HELD], ids=["recorded", "held"])
@pytest.mark.parametrize("text", MODELS.values(), ids=MODELS)
def test_the_nodes_at_a_sample_are_those_of_the_whole_simulation(text: str, data: kf.Dataset) -> None:
    values = parameters()
    problem = Problem(kf.formula(text, parameters=list(values)), (data,), values, (kf.Criterion("y", "z"),))
    bound, nodes = problem.bind(data), NodeSimulator(problem.graph, values, ["y"])
    whole = nodes.values(bound, values)
    for sample in (0, 5, 29, 30, bound.count - 1):
        assert nodes.at(bound, sample, values) == pytest.approx(whole[:, sample], rel=1e-12)
