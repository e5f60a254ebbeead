"""Limits of outputs hold at every sample of data in partitions, at the values that they have without."""

import numpy as np
import pytest

from kennfeld.analysis.limit_margins import output_ranges
from kennfeld.optimize.fit.fit import FitRun
from kennfeld.optimize.fit.result import Seconds
from kennfeld.optimize.strategies.limit_excess import FEASIBLE, LimitRound
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.preprocessing.prepared_files import ENDING
from kennfeld.project import Project
from tests.project.partitioned_projects import STEADY, TIMED, in_partitions, write_steady, write_timed

OFF = '\n[optimizer]\ncontinuation = "off"\ntolerance = 1e-8\n'
STEADY_LIMITS = """
[[limit]]
node = "TorqueModel"
max = 150.0
where = "n < 3500"

[[limit]]
node = "20 - TorqueModel"
max = 0
"""
TIMED_LIMITS = """
[[limit]]
node = "Lagged"
max = 2.0
"""
MEMORY_OF_A_LIMIT = """
[[limit]]
node = "PT1(TorqueModel, 0.5)"
max = 150.0
"""


def write_limited(folder):
    """Steady-state points of a function that is linear in its values, so that one end is the best."""
    first, _, rest = (STEADY + STEADY_LIMITS + OFF).partition("[parameters.C]")
    text = first + rest[rest.index("[[criterion]]") :]
    path = write_steady(folder, files=2, samples=150, text=text.replace("count = 6", "count = 3"))
    (folder / "torque.kf").write_text("input n[rpm]\ninput rl[%]\nTorqueModel = M(n, rl)\n")
    return path


def write_limited_drives(folder):
    return write_timed(folder, files=2, samples=200, text=TIMED + TIMED_LIMITS + OFF)


WRITERS = [write_limited, write_limited_drives]


def scattered(outputs):
    """Values far from the best ones, at which every limit is exceeded somewhere."""
    free = outputs._penalised.values.free
    start = outputs._penalised.start[:free]
    return start * np.random.default_rng(3).uniform(-1.0 if start[0] > 10 else 0.5, 4.0, free)


def values_of(result):
    return np.concatenate([np.ravel(result.parameters[name].values) for name in result.parameters])


def limits_of(path, size):
    project = Project.read(path) if size is None else in_partitions(path, size)
    return OutputLimits(project.problem())


@pytest.fixture(scope="module", params=WRITERS)
def calibrated(request, tmp_path_factory):
    """A project file, and the results without and with partitions."""
    path = request.param(tmp_path_factory.mktemp("limited"))
    return path, Project.read(path).calibrate(), in_partitions(path, 100).calibrate()


@pytest.mark.slow
def test_a_calibration_ends_at_the_values_without_partitions_within_its_limits(calibrated):
    check_ends(*calibrated, 100)


@pytest.mark.slow
def test_a_calibration_over_whole_files_ends_at_the_values_without_partitions(calibrated):
    path, plain, _ = calibrated
    check_ends(path, plain, in_partitions(path, 10**6).calibrate(), 10**6)


def check_ends(path, plain, parted, size):
    assert parted.status == plain.status == "converged"
    assert any(line.stage.startswith("limits") for line in parted.trace)
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-6)
    assert np.allclose(values_of(parted), values_of(plain), rtol=1e-3, atol=1e-3 * np.abs(values_of(plain)).max())
    for problem in (Project.read(path).problem(), in_partitions(path, size).problem()):
        assert [each.beyond for each in output_ranges(problem, parted.parameters)] == [0] * len(problem.limits)


@pytest.mark.slow
def test_the_samples_at_a_limit_and_their_derivatives_are_those_of_all_data(calibrated):
    path, result, parted_result = calibrated
    plain, parted = limits_of(path, None), limits_of(path, 100)
    check_near_active(plain, parted, plain._penalised.values.pack(result.parameters)[: plain._penalised.values.free])
    assert [(h.limit, h.directions, h.parameters) for h in parted_result.trust.holdings] == [
        (h.limit, h.directions, h.parameters) for h in result.trust.holdings
    ]


def check_near_active(plain, parted, values):
    expected, other = plain.near_active(values), parted.near_active(values)
    assert expected.side.size >= 1
    assert np.array_equal(
        np.transpose([other.side, other.data, other.sample]),
        np.transpose([expected.side, expected.data, expected.sample]),
    )
    assert np.allclose(other.rows, expected.rows, rtol=1e-9, atol=1e-12)
    assert np.allclose(other.excess, expected.excess, rtol=0, atol=1e-12)


@pytest.mark.parametrize("write", WRITERS)
def test_violations_are_named_like_those_without_partitions(tmp_path, write):
    path = write(tmp_path)
    plain, parted = limits_of(path, None), limits_of(path, 100)
    start = scattered(plain)
    assert plain.describe_violations(start).count("is exceeded at") == len(plain.sides)
    assert parted.describe_violations(start) == plain.describe_violations(start)
    expected, other = plain.measure(start), parted.measure(start)
    assert other.largest == pytest.approx(expected.largest, rel=1e-12)
    assert other.squares == pytest.approx(expected.squares, rel=1e-12)
    check_near_active(plain, parted, start)


@pytest.mark.parametrize("write", WRITERS)
def test_multipliers_and_the_penalised_cost_are_those_of_all_data(tmp_path, write):
    path = write(tmp_path)
    plain, parted = limits_of(path, None), limits_of(path, 100)
    start, rounds = scattered(plain), ()
    for growth in (1.0, 10.0):
        updates = [outputs.update(rounds, start) for outputs in (plain, parted)]
        assert updates[1].largest == pytest.approx(updates[0].largest, rel=1e-12)
        assert updates[1].gap == pytest.approx(updates[0].gap, rel=1e-12)
        rounds = (*rounds, LimitRound(plain.full(start), growth))
        start = start * 0.9
    costs = [outputs.penalise(3.0, rounds).cost(start) for outputs in (plain, parted)]
    assert costs[1] == pytest.approx(costs[0], rel=1e-12)
    assert costs[0] > plain.penalise(3.0, ()).cost(start)


def test_lost_multipliers_are_computed_again(tmp_path):
    path = write_limited(tmp_path)
    outputs = limits_of(path, 100)
    values = outputs._penalised.start[: outputs._penalised.values.free] * 1.7
    outputs.update((), values)
    rounds = (LimitRound(outputs.full(values), 1.0),)
    outputs.update(rounds, values * 0.9)
    rounds = (*rounds, LimitRound(outputs.full(values * 0.9), 10.0))
    cost = outputs.penalise(3.0, rounds).cost(values)
    for entry in (tmp_path / ".kennfeld" / "partitions").glob(f"*{ENDING}"):
        entry.unlink()
    assert limits_of(path, 100).penalise(3.0, rounds).cost(values) == cost


@pytest.mark.slow
def test_a_changed_condition_is_evaluated_again(tmp_path):
    path = write_limited(tmp_path)
    values = limits_of(path, 100)._penalised.start[:-1]
    costs = []
    for condition in ("n < 3500", "n < 1200", "n < 3500"):
        path.write_text(path.read_text().replace("n < 3500", condition).replace("n < 1200", condition))
        outputs = limits_of(path, 100)
        values = outputs._penalised.start[: outputs._penalised.values.free] * 1.7
        costs.append(outputs.penalise(100.0, ()).cost(values))
    assert costs[1] < costs[0] == costs[2]


@pytest.mark.slow
def test_equal_samples_at_a_limit_are_taken_in_their_order(tmp_path):
    text = STEADY + '\n[[limit]]\nnode = "min(TorqueModel, 90)"\nmax = 90\n'
    path = write_steady(tmp_path, files=3, samples=500, text=text)
    plain, parted = limits_of(path, None), limits_of(path, 100)
    values = plain._penalised.start[: plain._penalised.values.free] * 2
    expected, other = plain.near_active(values), parted.near_active(values)
    assert np.array_equal(other.sample, expected.sample)
    assert expected.sample.size == 400
    assert np.all(np.diff(expected.sample) > 0)


@pytest.mark.slow
def test_pieces_are_not_divided_for_a_limit_with_memory(tmp_path):
    text = STEADY + MEMORY_OF_A_LIMIT
    path = write_steady(
        tmp_path,
        files=3,
        samples=200,
        text=text.replace('files = ["bench_*.csv"]', 'files = ["bench_*.csv"]\nraster = 0.1'),
    )
    for file in tmp_path.glob("*.csv"):
        header, *rows = file.read_text().splitlines()
        file.write_text("\n".join([f"time,{header}", *(f"{0.1 * k:.1f},{row}" for k, row in enumerate(rows))]))
    partitions = in_partitions(path, 100).problem().partitions
    assert [len(partition.parts) for partition in partitions.training] == [1, 1, 1]
    plain, parted = limits_of(path, None), limits_of(path, 100)
    start = plain._penalised.start[: plain._penalised.values.free] * 2
    assert parted.describe_violations(start) == plain.describe_violations(start) != ""


@pytest.mark.slow
def test_contradictory_limits_are_reported_with_their_distance(tmp_path):
    path = write_limited(tmp_path)
    path.write_text(path.read_text() + '\n[[limit]]\nnode = "TorqueModel"\nmin = 160.0\nwhere = "n < 2000"\n')
    path.write_text(path.read_text().replace("tolerance = 1e-8", "tolerance = 1e-2"))
    result = in_partitions(path, 200).calibrate()
    assert result.status == "infeasible"
    assert "TorqueModel >= 160 is exceeded at" in result.message


@pytest.mark.slow
def test_a_global_search_respects_limits_in_partitions(tmp_path):
    text = TIMED + TIMED_LIMITS + '\n[optimizer]\nmethod = "global"\nmax_evaluations = 30\n'
    text = text.replace("smoothness = 1e-4", "bounds = [0, 5]").replace("count = 5", "count = 3")
    path = write_timed(tmp_path, files=2, samples=150, text=text)
    result = in_partitions(path, 150).calibrate()
    (reached,) = output_ranges(in_partitions(path, 150).problem(), result.parameters)
    assert reached.greatest <= 2.0 * (1 + FEASIBLE)
    assert result.cost_after < result.cost_before


def test_weights_of_a_penalised_problem_reach_every_partition(tmp_path):
    outputs = limits_of(write_limited_drives(tmp_path), 400)
    objective = outputs.penalise(1e6, ())
    start = scattered(outputs)
    assert objective._compiled.weights > 100 * outputs._penalised.weights
    assert objective.cost(start) > 100 * outputs.penalise(1.0, ()).cost(start)


def test_the_cost_of_the_result_is_that_without_penalty(tmp_path):
    path = write_limited_drives(tmp_path)
    path.write_text(path.read_text().replace("tolerance = 1e-8", "max_iterations = 1"))
    project = in_partitions(path, 100)
    run = FitRun(project.problem(), project.options, None, Seconds(0.0, 0.0, 0.0, 0.0))
    result = run.result()
    assert result.cost_after == pytest.approx(
        run.objective.cost(run.exact.values.pack(result.parameters)[: run.exact.values.free]), rel=1e-9
    )
    plain = Project.read(path).calibrate()
    assert np.allclose(values_of(result), values_of(plain), rtol=1e-6)
