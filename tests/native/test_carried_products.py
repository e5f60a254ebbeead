"""Sums of sweeps over models with memory are those of the rows of all columns, carried through the states."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.analysis.missing import candidate_sums
from kennfeld.analysis.missing.candidate_columns import block_runs
from kennfeld.analysis.missing.candidate_shares import RowShare
from kennfeld.analysis.missing.candidate_sums import block_sums, family_sums
from kennfeld.analysis.missing.families import HatAxis, Series, channel_families, map_families, series_families
from kennfeld.analysis.missing.probes import Nodes, Probes
from kennfeld.native import accumulator, carried_products
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning.holdout_blocks import HoldoutBlocks

MODELS = {
    "one state": "a = C(x)\ny = PT1(a, T)",
    "a start that depends on values": "a = C(x)\ny = PT1(a, T) + k * prev(a, k)",
    "a delay": "a = C(x) * z\nb = delay(a, 7, k)\ny = PT1(a + b, T)",
    "a delay longer than a part": "a = C(x) * z\nb = delay(a, 150, k)\ny = PT1(a + b, T) + delay(b, 3, 0)",
    "feedback": "a = C(x)\ny = 0.6 * prev(y, 0) - 0.3 * prev(prev(y, 0), 0) + a * T",
    "an integrator": "a = C(x)\nb = integrator(a - k * z, 0, -9, 9)\ny = b + T * a",
}
AXES = (HatAxis("z", "z", (-1.0, -0.3, 0.4, 1.0)), HatAxis("w", "w", (-0.5, 0.5)))
SAMPLES = 700


def compiled_problem(text, outputs=1):
    rng = np.random.default_rng(0)
    data = {name: rng.uniform(-1, 1, SAMPLES) for name in ("x", "z", "w", "m", "l")} | {
        "time": 0.1 * np.arange(SAMPLES)
    }
    data["m"][50:90] = np.nan
    parameters = {"C": kf.Curve("C", [-1, -0.5, 0, 1], [0.5, 1.0, 3.0, 2.0]), "T": 0.4, "k": 0.3}
    start = {name: value for name, value in parameters.items() if name in text}
    criteria = [kf.Criterion("y", channel) for channel in ("m", "l")[:outputs]]
    problem = ProblemSetup(text, data, start, criteria=criteria).problem()
    nodes = Nodes.of(problem)
    probes = Probes.of(problem, nodes.names)
    return CompiledProblem(probes.problem), probes, nodes


def all_families(compiled, probes, nodes):
    free = compiled.values.free
    yield from channel_families(probes, AXES, ("add", "multiply"), nodes.constant, free)
    yield from map_families(probes, [AXES], ("add",), nodes.constant, free)
    moving = [name for name in nodes.names if name not in nodes.constant]
    series = [Series(node, "lag", seconds=0.5) for node in moving] + [Series(node, "delay", steps=2) for node in moving]
    yield from series_families(probes, series)


CASES = [
    ("one state", 1),
    ("a delay longer than a part", 2),
    *(pytest.param(name, 1, marks=pytest.mark.slow) for name in [*MODELS][1:]),
    *(pytest.param(name, 2, marks=pytest.mark.slow) for name in [*MODELS] if "longer" not in name),
]


@pytest.mark.parametrize(("name", "outputs"), CASES)
def test_sums_of_sweeps_are_those_of_rows(monkeypatch, name, outputs):
    # several chunks, over which all families go in turn
    monkeypatch.setattr(accumulator, "TAPE_BYTES", 16_000)
    monkeypatch.setattr(carried_products, "DEEP", 1000)
    compiled, probes, nodes = compiled_problem(MODELS[name], outputs)
    assert compiled.kernel.pattern.carried
    blocks = HoldoutBlocks.of(compiled, 5)
    arguments = (compiled.start, blocks.divisions, blocks.sizes.size)
    families = [*all_families(compiled, probes, nodes)]
    swept = family_sums(compiled, families, *arguments)
    pulled = block_sums(compiled, *arguments).jr
    monkeypatch.setattr(candidate_sums, "share_of", RowShare)
    monkeypatch.setattr(candidate_sums, "has_carried_sweeps", lambda kernel: False)
    np.testing.assert_allclose(pulled, block_sums(compiled, *arguments).jr, rtol=1e-11, atol=1e-11)
    own = slice(0, min(compiled.values.offsets[name] for name in compiled.values.offsets if name.startswith("\0")))
    assert own.stop
    for family, sums in zip(families, swept, strict=True):
        [rows] = family_sums(compiled, [family], *arguments)
        np.testing.assert_allclose(sums.jb[own], rows.jb[own], rtol=1e-11, atol=1e-10)
        np.testing.assert_allclose(sums.br, rows.br, rtol=1e-11, atol=1e-10)
        for factor, others in zip(sums.squares, rows.squares, strict=True):
            for matrix, other in zip(factor, others, strict=True):
                np.testing.assert_allclose(matrix, other, rtol=1e-11, atol=1e-10)
                assert np.array_equal(matrix, matrix.transpose(0, 2, 1))


def test_runs_of_a_block_follow_each_other():
    assert block_runs(np.array([2, 2, 0, 1, 1], dtype=np.int32)) == [(0, 2), (2, 3), (3, 5)]


def test_many_states_and_long_delays_take_rows():
    few, long = (compiled_problem(f"a = C(x)\ny = delay(a, {steps}, 0)")[0] for steps in (60, 90))
    assert carried_products.has_carried_sweeps(few.kernel)
    assert not carried_products.has_carried_sweeps(long.kernel)
