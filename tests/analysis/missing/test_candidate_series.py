"""The series of lags and delays that are simulated beside a tape are those of a simulation of all samples."""

import numpy as np

from kennfeld.analysis.missing import candidate_series
from kennfeld.analysis.missing.candidate_series import SeriesSource, goes_along
from kennfeld.analysis.missing.families import Series
from kennfeld.analysis.missing.probes import Nodes, Probes
from kennfeld.native import accumulator
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.sums.compiled import CompiledProblem

SERIES = [Series("y", "lag", seconds=3.0), Series("a", "delay", steps=5)]


def recording(seed, samples=400):
    rng = np.random.default_rng(seed)
    data = {name: rng.uniform(-1, 1, samples) for name in ("x", "m")} | {"time": 0.1 * np.arange(samples)}
    data["x"][150] = np.nan
    return data


def compiled_problem(text):
    problem = ProblemSetup(text, [recording(0), recording(1)], {"k": 1.0}, "m", node="y").problem()
    return CompiledProblem(Probes.of(problem, Nodes.of(problem).names).problem)


def series_of(compiled):
    """Return the series at all visits, Float[visits, series]."""
    source, readers, values = SeriesSource(compiled, SERIES, compiled.start), {}, {}

    def visit(share, space, chunk, begins):
        reader = readers.setdefault(share, source.reader())
        values[chunk.first] = reader.read(chunk, begins)

    compiled.sums.each_tape(compiled.start, visit)
    return np.concatenate([values[first] for first in sorted(values)])


def test_series_beside_the_tape_are_those_of_all_samples(monkeypatch):
    # chunks of a few samples, from which the simulation goes on
    monkeypatch.setattr(accumulator, "TAPE_BYTES", 1000)
    compiled = compiled_problem("a = k * x\ny = PT1(a, 0.5)")
    assert goes_along(compiled)
    along = series_of(compiled)
    monkeypatch.setattr(candidate_series, "goes_along", lambda compiled: False)
    np.testing.assert_array_equal(along, series_of(compiled))
    assert np.ptp(along, axis=0).min() > 0.1


def test_without_memory_the_series_of_all_samples_are_stored():
    compiled = compiled_problem("a = k * x\ny = a + 1")
    assert not goes_along(compiled)
    assert series_of(compiled).shape == (compiled.samples.count, len(SERIES))
