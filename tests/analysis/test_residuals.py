from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld import Criterion, Cube, Curve, Dataset, Map, ParameterSet, Scalar, formula
from kennfeld.analysis.cell_errors import tally
from kennfeld.analysis.evaluation import Evaluator
from kennfeld.analysis.leverage import LookupWeights
from kennfeld.analysis.residual_statistics import ErrorCounts, ErrorRange
from kennfeld.analysis.residuals import analyse, residuals
from kennfeld.base.sample_statistics import Moments, Ranks
from kennfeld.optimize import Problem
from kennfeld.optimize.quality.lookup_coverage import Lookups, coordinates


def problem_of(text, parameters, *datasets, criteria=(("y", "t"),)):
    return Problem(
        formula(text, parameters=[p.name for p in parameters]),
        datasets,
        ParameterSet(parameters),
        tuple(Criterion(node, target) for node, target in criteria),
    )


def scattered(count=400, seed=0, **attributes):
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(-1, 11, count), rng.uniform(0, 5, count)
    return Dataset.of("d", {"x": x, "z": z, "t": rng.normal(size=count) + x}, units={"t": "Nm"}, **attributes)


def sample_leverage(problem, leverage):
    """Leverage of each sample of the only criterion of a problem, at its own values."""
    lookups = Lookups(problem, problem.parameters)
    series = Evaluator(problem).series(problem.parameters)
    located = list(lookups.blocks(series[0].bound))
    weights = LookupWeights.of(problem, lookups, located, series, leverage)
    return weights.leverage(problem, lookups, located, series[0], leverage)


def test_errors_are_model_minus_measurement():
    data = Dataset.of("d", {"x": [1.0, 2.0, 3.0], "t": [2.0, np.nan, 0.0]}, units={"t": "Nm"})
    line = Curve("Line", [0, 4], [0, 4.0])
    (analysis,) = residuals(problem_of("y = Line(x)", [line], data), ParameterSet([line]))
    (errors,) = analysis.errors
    np.testing.assert_array_equal(errors.absolute, [-1.0, np.nan, 3.0])
    np.testing.assert_array_equal(errors.relative, [-0.5, np.nan, np.nan])
    np.testing.assert_allclose(errors.scaled, np.array([-1.0, np.nan, 3.0]) / np.sqrt(5.0))
    assert (analysis.scaling, analysis.unit) == ("standardised", "Nm")
    assert [(w.sample, w.error, w.inputs) for w in analysis.worst] == [(2, 3.0, {"x": 3.0}), (0, -1.0, {"x": 1.0})]


def test_the_summary_counts_scored_samples_alone():
    data = scattered(scored=np.arange(400) % 2 == 0)
    curve = Curve("C", [0, 10], [0.0, 10.0])
    (analysis,) = residuals(problem_of("y = C(x) + 0*z", [curve], data), ParameterSet([curve]))
    (row,) = analysis.summaries
    error = (np.clip(data["x"].values, 0, 10) - data["t"].values)[::2]
    assert row.samples == 200
    assert row.mean == pytest.approx(error.mean())
    assert row.rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    assert row.largest == pytest.approx(np.abs(error).max())
    assert row.percentile_95 == pytest.approx(np.quantile(np.abs(error), 0.95))
    target = data["t"].values[::2]
    assert row.r2 == pytest.approx(1 - np.mean(error**2) / target.var())


@pytest.mark.slow
@settings(deadline=None, max_examples=25)
@given(st.integers(0, 1000), st.integers(2, 5), st.integers(1, 4))
def test_cells_hold_every_known_sample_once(seed, rows, columns):
    data = scattered(150, seed)
    table = Map("M", np.linspace(0, 10, rows), np.linspace(1, 4, columns), np.zeros((rows, columns)))
    problem = problem_of("y = M(x, z)", [table], data)
    (analysis,) = residuals(problem, problem.parameters)
    (cells,) = analysis.cells
    assert cells.samples.shape == (max(rows - 1, 1), max(columns - 1, 1))
    assert cells.samples.sum() == 150
    np.testing.assert_allclose(np.nansum(cells.samples * cells.mean), analysis.errors[0].absolute.sum())
    np.testing.assert_allclose(np.nansum(cells.samples * cells.rmse**2), np.sum(analysis.errors[0].absolute ** 2))
    assert np.isnan(cells.mean[cells.samples == 0]).all()


def test_a_cell_lies_between_its_breakpoints():
    data = Dataset.of("d", {"x": [-5.0, 0.0, 9.9, 10.0, 20.0, 99.0], "t": np.arange(6.0)})
    curve = Curve("C", [0, 10, 20], [0.0, 0.0, 0.0])
    (analysis,) = residuals(problem_of("y = C(x)", [curve], data), ParameterSet([curve]))
    assert analysis.cells[0].samples.tolist() == [3, 3]
    assert analysis.cells[0].mean.tolist() == [-1.0, -4.0]


def test_cells_belong_to_the_criteria_that_the_table_changes():
    data = Dataset.of("d", {"x": [1.0, 2.0], "t": [1.0, 2.0]})
    tables = [Curve("A", [0, 10], [0.0, 0.0]), Curve("B", [0, 10], [0.0, 0.0])]
    problem = problem_of("y = A(x)\nz = y + B(x)", tables, data, criteria=(("y", "t"), ("z", "t")))
    first, second = residuals(problem, problem.parameters)
    assert [c.parameter for c in first.cells] == ["A"]
    assert sorted(c.parameter for c in second.cells) == ["A", "B"]


def test_coordinates_that_a_parameter_moves_are_followed():
    data = Dataset.of("d", {"x": [1.0, 2.0, 3.0], "t": [0.0, 0.0, 0.0]})
    tables = [Scalar("K", 10.0), Curve("C", [0, 15, 25, 40], [0.0] * 4)]
    problem = problem_of("y = C(K * x)", tables, data)
    (analysis,) = residuals(problem, problem.parameters)
    assert analysis.cells[0].samples.tolist() == [1, 1, 1]
    for computed in (True, False):
        evaluator = Evaluator(problem, coordinates(problem))
        series = evaluator.series(problem.parameters)
        lookups = Lookups(problem, problem.parameters, evaluator.values if computed else ())
        assert tally(lookups, problem.parameters, series).touching["C"].tolist() == [1, 2, 2, 1]


def test_grid_points_count_the_training_samples_that_give_them_a_weight():
    training = Dataset.of("a", {"x": [10.0, 12.0, np.nan, 14.0], "t": [1.0, 1.0, 1.0, np.nan]})
    test = Dataset.of("b", {"x": [25.0], "t": [0.0]}, use="test")
    curve = Curve("C", [0, 10, 20, 30], [0.0] * 4)
    problem = problem_of("y = C(x)", [curve], training, test)
    series = Evaluator(problem).series(problem.parameters)
    assert tally(Lookups(problem, problem.parameters), problem.parameters, series).touching["C"].tolist() == [
        0,
        2,
        1,
        0,
    ]


def test_grid_points_with_counts_of_the_trust_are_not_counted_again():
    data = Dataset.of("d", {"x": [1.0, 2.0], "t": [0.0, 0.0]})
    tables = [Curve("A", [0, 10], [0.0] * 2), Curve("B", [0, 10], [0.0] * 2)]
    problem = problem_of("y = A(x) + B(x)", tables, data)
    trust = SimpleNamespace(samples={"A": np.array([5, 5])})
    counted = analyse(problem, problem.parameters, problem.parameters, trust=trust).touching
    assert {name: count.tolist() for name, count in counted.items()} == {"B": [2, 2]}


def test_many_samples_are_taken_block_by_block(monkeypatch):
    data = scattered(1000)
    table = Cube("M", [[0, 5, 10], [0, 2, 5], [0, 1]], np.zeros((3, 3, 2)))
    problem = problem_of("y = M(x, z, sin(x))", [table], data)
    (whole,) = residuals(problem, problem.parameters)
    monkeypatch.setattr("kennfeld.optimize.quality.lookup_coverage.SAMPLES_PER_BLOCK", 64)
    (parts,) = residuals(problem, problem.parameters)
    np.testing.assert_array_equal(parts.cells[0].samples, whole.cells[0].samples)
    np.testing.assert_allclose(parts.cells[0].mean, whole.cells[0].mean)


@dataclass
class Trust:
    leverage: dict = field(default_factory=dict)


def hats(x, points):
    return np.array([np.interp(x, points, row) for row in np.eye(len(points))]).T


class TestStudentized:
    points = np.linspace(0.0, 10.0, 6)

    def leverage(self, x):
        """Of the grid points, for a table alone: the diagonal of X'X (X'X)^+."""
        matrix = hats(x, self.points).T @ hats(x, self.points)
        return np.diag(matrix @ np.linalg.pinv(matrix))

    def test_agrees_with_the_hat_matrix_for_samples_on_the_grid_points(self):
        rng = np.random.default_rng(0)
        x = rng.choice(self.points, 40)
        data = Dataset.of("d", {"x": x, "t": rng.normal(size=40)})
        values, *_ = np.linalg.lstsq(hats(x, self.points), data["t"].values, rcond=None)
        curve = Curve("C", self.points, values)
        problem = problem_of("y = C(x)", [curve], data)
        (analysis,) = residuals(problem, problem.parameters, trust=Trust({"C": self.leverage(x)}))
        rows = hats(x, self.points)
        hat = np.diag(rows @ np.linalg.pinv(rows))
        error = rows @ values - data["t"].values
        deviation = np.sqrt(np.sum(error**2) / (40 - hat.sum()))
        inner = hat < 1 - 1e-9
        np.testing.assert_allclose(
            analysis.errors[0].scaled[inner], (error / deviation / np.sqrt(1 - hat))[inner], rtol=1e-9
        )
        assert analysis.scaling == "studentized"
        assert analysis.deviation == pytest.approx(deviation)

    @settings(deadline=None, max_examples=20)
    @given(st.integers(0, 1000))
    def test_leverage_adds_up_to_what_the_data_determine(self, seed):
        rng = np.random.default_rng(seed)
        x = rng.uniform(0, 10, 200)
        data = Dataset.of("d", {"x": x, "t": rng.normal(size=200)})
        problem = problem_of("y = C(x)", [Curve("C", self.points, np.zeros(6))], data)
        leverage = sample_leverage(problem, {"C": self.leverage(x)})
        assert leverage.sum() == pytest.approx(self.leverage(x).sum())
        assert ((leverage >= 0) & (leverage < 1)).all()

    def test_a_sample_pulls_as_hard_as_it_weighs(self):
        """The diagonal of the weighted hat matrix, where samples lie on grid points."""
        rng = np.random.default_rng(2)
        x, w = rng.choice(self.points, 60), np.where(rng.random(60) < 0.2, 0.0, rng.uniform(0.1, 9, 60))
        data = Dataset.of("d", {"x": x, "t": rng.normal(size=60), "w": w}, weight_channel="w")
        problem = problem_of("y = C(x)", [Curve("C", self.points, np.zeros(6))], data)
        leverage = sample_leverage(problem, {"C": np.ones(6)})
        rows = np.sqrt(w)[:, None] * hats(x, self.points)
        expected = np.diag(rows @ np.linalg.pinv(rows))
        np.testing.assert_allclose(leverage, np.minimum(expected, 0.999), rtol=1e-9, atol=1e-12)

    def test_a_sample_that_decides_a_value_alone_has_no_error_to_judge(self):
        x = np.r_[np.full(30, 2.0), 8.0]
        data = Dataset.of("d", {"x": x, "t": np.r_[np.tile([1.0, -1.0], 15), 5.0]})
        curve = Curve("C", self.points, [0, 0, 0, 0, 5.0, 0])
        problem = problem_of("y = C(x)", [curve], data)
        (analysis,) = residuals(problem, problem.parameters, trust=Trust({"C": self.leverage(x)}))
        assert abs(analysis.errors[0].scaled[30]) < 1e-6

    @pytest.mark.slow
    @settings(deadline=None, max_examples=15)
    @given(st.integers(0, 1000), st.integers(3, 300), st.sampled_from([0.0, 1.0, 1e160]), st.booleans())
    def test_errors_beyond_three_deviations_are_counted_before_these_are_known(self, seed, count, size, studentized):
        rng = np.random.default_rng(seed)
        x = rng.uniform(0, 10, count)
        data = Dataset.of("d", {"x": x, "t": size * rng.standard_t(2, count)})
        test = Dataset.of("e", {"x": rng.uniform(0, 10, 50), "t": 5 * size * rng.standard_t(2, 50)}, use="test")
        problem = problem_of("y = C(x)", [Curve("C", self.points, np.zeros(6))], data, test)
        trust = Trust({"C": self.leverage(x)}) if studentized else None
        (analysed,) = residuals(problem, problem.parameters, trust=trust)
        for errors, summary in zip(analysed.errors, analysed.summaries, strict=True):
            known = errors.scaled[np.isfinite(errors.scaled)]
            share = np.mean(np.abs(known) > 3.0) if known.size else np.nan
            assert summary.beyond == pytest.approx(share, nan_ok=True)

    def test_test_samples_had_no_part_in_the_fit(self):
        data = scattered()
        problem = problem_of(
            "y = C(x) + 0*z", [Curve("C", self.points, np.zeros(6))], data, replace(data, name="e", use="test")
        )
        (analysis,) = residuals(problem, problem.parameters, trust=Trust({"C": np.ones(6)}))
        training, test = analysis.errors
        np.testing.assert_allclose(test.scaled, test.absolute / analysis.deviation)
        assert (np.abs(training.scaled) > np.abs(test.scaled)).all()


def test_a_target_may_be_a_node_or_a_number():
    data = Dataset.of("d", {"x": [1.0, 2.0]})
    problem = problem_of("y = K * x\nz = x^2", [Scalar("K", 3.0)], data, criteria=(("y", "z"), ("y", 4.0)))
    against_node, against_number = residuals(problem, problem.parameters)
    assert [w.measured for w in sorted(against_node.worst, key=lambda w: w.sample)] == [1.0, 4.0]
    assert against_node.errors[0].absolute.tolist() == [2.0, 2.0]
    assert against_number.errors[0].absolute.tolist() == [-1.0, 2.0]


def test_recordings_have_an_autocorrelation_and_a_piece():
    rng = np.random.default_rng(0)
    time = np.r_[np.arange(300) * 0.1, np.arange(200) * 0.1]
    data = Dataset.of("d", {"x": np.zeros(500), "t": rng.normal(size=500)}, time=time, piece_starts=np.array([0, 300]))
    curve = Curve("C", [0, 1], [0.0, 0.0])
    (analysis,) = residuals(problem_of("y = C(x)", [curve], data), ParameterSet([curve]), worst=500)
    memory = analysis.summaries[0].autocorrelation
    assert memory.unit == "s"
    assert memory.lags[1] == pytest.approx(0.1)
    late = next(w for w in analysis.worst if w.sample == 300)
    assert (late.piece, late.time) == (1, 0.0)


def test_nonfinite_errors_are_worst_and_do_no_harm():
    data = Dataset.of("d", {"x": [0.0, 1.0, 2.0], "t": [1.0, 1.0, 1.0]})
    curve = Curve("C", [0, 3], [1.0, 2.0])
    (analysis,) = residuals(problem_of("y = log(x) + C(x)", [curve], data), ParameterSet([curve]))
    assert analysis.worst[0].sample == 0
    assert not np.isfinite(analysis.worst[0].error)


@pytest.mark.parametrize("count", [0, 1])
def test_one_sample_or_none(count):
    data = Dataset.of("d", {"x": [1.0], "t": [3.0 if count else np.nan]})
    curve = Curve("C", [0, 3], [1.0, 2.0])
    analyses = residuals(problem_of("y = C(x)", [curve], data), ParameterSet([curve]))
    assert len(analyses) == count
    for entry in analyses:
        assert len(entry.worst) == 1
        assert np.isnan(entry.summaries[0].r2)


def test_neighbours_in_time_with_errors_of_one_sign_are_one_event():
    error = np.array([0.0, 1, 3, 2, -1, -4, -1, 5, 5, np.nan, 2, 7, 1])
    data = Dataset.of(
        "d", {"x": np.zeros(13), "t": -error}, time=np.arange(13) * 0.1, piece_starts=np.array([0, 12]), scored=None
    )
    curve = Curve("C", [0, 1], [0.0, 0.0])
    (analysis,) = residuals(problem_of("y = C(x)", [curve], data), ParameterSet([curve]))
    assert [(w.sample, w.error) for w in analysis.worst] == [(11, 7), (7, 5), (5, -4), (2, 3), (12, 1), (0, 0)]


@pytest.mark.parametrize("first", [(np.nan,) * 3, (0.1, 0.1, 0.1)])
def test_the_step_is_that_of_the_parts_that_have_one(first):
    none = np.zeros(0)
    parts = [
        ErrorCounts(
            Moments.of(none), Moments.of(none), ErrorRange.of(none), ErrorRange.of(none), Ranks.of(none), steps, ""
        )
        for steps in (first, (0.1, 0.1, 0.1), (np.nan,) * 3)
    ]
    for part in parts[1:]:
        parts[0].merge(part)
    assert parts[0].step == 0.1
