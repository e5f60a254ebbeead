"""Projects whose data are evaluated in partitions give what they give in one piece, however the partitions are cut."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from pyarrow import parquet

from kennfeld.analysis.cross_validation import cross_validate
from kennfeld.base import column_file, file_state
from kennfeld.base.errors import InputError
from kennfeld.base.task_runner import SerialRunner
from kennfeld.optimize.fit.fit import FitRun
from kennfeld.optimize.fit.result import Seconds
from kennfeld.optimize.problem.partitions import shared_content
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.strategies.smoothing_continuation import Continuation
from kennfeld.optimize.sums import compiled as compiled_form
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.preprocessing import prepared_files
from kennfeld.preprocessing.prepared_files import ENDING, PreparedFiles
from kennfeld.project import Project, partitioned_loading
from kennfeld.project.results import write_simulation
from tests.draws import mostly_slow
from tests.project.partitioned_projects import (
    FEW,
    OFF,
    STEADY,
    TIMED,
    in_partitions,
    write_steady,
    write_timed,
    write_uneven,
)

WRITERS = [write_steady, write_timed, write_uneven]


def write_few(folder, text=FEW + OFF):
    return write_steady(folder, files=2, samples=200, text=text)


def write_few_drives(folder):
    return write_timed(folder, files=2, samples=150)


SIZES = mostly_slow([300, 10**6], 1)  # files are cut, or are one partition

# written files, and the size of partitions
FITTED = [
    pytest.param(None, id="few points", marks=pytest.mark.slow),  # shared with another test
    pytest.param((write_few_drives, 150), id="few drives"),
    pytest.param((write_steady, 300), id="points", marks=pytest.mark.slow),
]


def close(first, second, tolerance=1e-10):
    return np.allclose(first, second, rtol=tolerance, atol=tolerance * np.abs(second).max(initial=0.0))


def compiled_pair(folder, write, size):
    path = write(folder)
    return (CompiledProblem(project.problem()) for project in (Project.read(path), in_partitions(path, size)))


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("size", SIZES)
def test_sums_are_those_of_all_data(tmp_path, write, size):
    plain, parted = compiled_pair(tmp_path, write, size)
    values = plain.start * 1.01
    assert close(parted.start, plain.start, 0)
    assert close(parted.sums.cost(values), plain.sums.cost(values))
    whole, added = plain.sums.normal(values), parted.sums.normal(values)
    assert close(added.gradient, whole.gradient)
    assert close(added.matrix, whole.matrix)
    assert np.array_equal(parted.sums.touched(values), plain.sums.touched(values))
    assert parted.weights == pytest.approx(plain.weights, rel=1e-12)


def test_partitions_are_evaluated_once_for_the_same_values(tmp_path, monkeypatch):
    compiled, calls = CompiledProblem(in_partitions(write_timed(tmp_path), 500).problem()), []
    run_tasks = SerialRunner.map

    def count(self, task, *arguments):
        calls.append(task)
        return run_tasks(self, task, *arguments)

    monkeypatch.setattr(SerialRunner, "map", count)
    cost, normal = compiled.sums.cost(compiled.start), compiled.sums.normal(compiled.start)
    gradient, matrix = normal.gradient.copy(), normal.matrix.copy()
    normal.matrix[:] = 0.0  # as callers may
    assert compiled.sums.cost(compiled.start) == cost
    assert np.array_equal(compiled.sums.normal(compiled.start).gradient, gradient)
    assert np.array_equal(compiled.sums.normal(compiled.start).matrix, matrix)
    assert len(calls) == 2
    compiled.sums.cost(compiled.start * 1.01)
    assert len(calls) == 3


@pytest.mark.parametrize("write", WRITERS)
def test_rows_are_those_of_all_data(tmp_path, write):
    plain, parted = compiled_pair(tmp_path, write, 300)
    residual, jacobian = plain.sums.rows(plain.start)
    others, further = parted.sums.rows(plain.start)
    assert close(np.sort(others), np.sort(residual))
    assert close(further.T @ further, jacobian.T @ jacobian)
    visits = np.array([0, 5, 700])
    assert np.array_equal(parted.sums.rows_at(plain.start, visits)[:, 0], further[visits])


@pytest.mark.parametrize("write", WRITERS)
def test_derivatives_of_faint_values_are_judged_as_without_partitions(tmp_path, write):
    plain, parted = compiled_pair(tmp_path, write, 300)
    expected, other = LeastSquaresObjective(plain), LeastSquaresObjective(parted)
    assert close(
        other.mean_curvature(np.ones(expected.start.size)), expected.mean_curvature(np.ones(expected.start.size))
    )
    assert np.array_equal(other.faint(other.start), expected.faint(expected.start))


def fit_pair(folder, write, size):
    """Return the results without and with partitions."""
    path = write(folder)
    return Project.read(path).calibrate(), in_partitions(path, size).calibrate()


@pytest.fixture(scope="module")
def few_fitted(tmp_path_factory):
    return fit_pair(tmp_path_factory.mktemp("few"), write_few, 150)


@pytest.fixture(scope="module", params=FITTED)
def fitted(request, tmp_path_factory):
    if request.param is None:
        return request.getfixturevalue("few_fitted")
    return fit_pair(tmp_path_factory.mktemp("fitted"), *request.param)


def test_a_calibration_ends_at_the_same_values(fitted):
    plain, parted = fitted
    assert parted.status == plain.status == "converged"
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-7)
    assert parted.cost_before == pytest.approx(plain.cost_before, rel=1e-12)
    for row, other in zip(plain.quality, parted.quality, strict=True):
        assert (row.criterion, row.dataset, row.use, row.samples) == (
            other.criterion,
            other.dataset,
            other.use,
            other.samples,
        )
        assert other.rmse_before == pytest.approx(row.rmse_before, rel=1e-9)
        assert other.rmse_after == pytest.approx(row.rmse_after, rel=1e-4)
        assert other.r2_after == pytest.approx(row.r2_after, rel=1e-4)
        assert other.max_abs_after == pytest.approx(row.max_abs_after, rel=1e-2)


@pytest.mark.slow
def test_uncertainties_are_those_of_all_data(few_fitted):
    assert_same_trust(*(result.trust for result in few_fitted))


def assert_same_trust(plain, parted):
    assert parted.noise == pytest.approx(plain.noise, rel=1e-4)
    for name in plain.deviation:
        assert np.array_equal(parted.samples[name], plain.samples[name])
        assert np.allclose(parted.deviation[name], plain.deviation[name], rtol=1e-2)


LASTING = """
[model]
file = "level.kf"

[[dataset]]
name = "drives"
files = ["run_*.csv"]

[parameters.C]
x = { input = "x", begin = 0, end = 1, count = 6 }
initial = 0.5

[[criterion]]
node = "y"
target = { channel = "m" }
"""


def write_lasting(folder, memories=(0.95, 0.95), offset=0.0):
    """Recordings of 400 samples whose errors last, and a curve over a slow input that takes part of them."""
    random = np.random.default_rng(0)
    for number, memory in enumerate(memories):
        errors = np.zeros(400)
        for k in range(1, 400):
            errors[k] = memory * errors[k - 1] + random.normal()
        errors += offset * number
        x = np.linspace(0, 1, 400)
        rows = [f"{0.1 * k:.3f},{x[k]:.6f},{x[k] + errors[k]:.6f}" for k in range(400)]
        (folder / f"run_{number}.csv").write_text("\n".join(["time,x,m", *rows]) + "\n", encoding="utf-8")
    (folder / "level.kf").write_text("y = C(x)\n", encoding="utf-8")
    (folder / "kennfeld.toml").write_text(LASTING, encoding="utf-8")
    return folder / "kennfeld.toml"


@pytest.mark.slow
def test_persistence_is_corrected_for_the_fitted_values_in_partitions(tmp_path):
    path = write_lasting(tmp_path)
    plain, parted = (project.calibrate().trust for project in (Project.read(path), in_partitions(path, 400)))
    [group] = plain.estimate.groups
    assert group.correlation.window == 1  # it was corrected, and counts as white since then
    assert parted.persistence == pytest.approx(plain.persistence, rel=0.1)
    np.testing.assert_allclose(parted.deviation["C"], plain.deviation["C"], rtol=0.05)


@pytest.mark.parametrize(("memories", "offset"), [((0.95, 0, 0), 0.0), ((0, 0, 0), 0.5)])
def test_persistent_errors_of_files_are_measured_in_partitions(tmp_path, memories, offset):
    path = write_lasting(tmp_path, memories, offset)
    plain, parted = (project.calibrate().trust for project in (Project.read(path), in_partitions(path, 400)))
    assert plain.persistence["y"] > 10
    assert parted.persistence == pytest.approx(plain.persistence, rel=0.1)


def test_the_sample_of_a_derivative_that_is_not_finite_is_named_in_partitions(tmp_path):
    path = write_lasting(tmp_path)
    (tmp_path / "level.kf").write_text("y = C(x) + k * sqrt(p - x)\n", encoding="utf-8")
    scalars = "\n[parameters.p]\ninitial = 1.0\n[parameters.k]\ninitial = 1.0\n"
    path.write_text(LASTING + scalars, encoding="utf-8")
    plain, parted = (project.calibrate() for project in (Project.read(path), in_partitions(path, 400)))
    assert "The derivative of y is not finite at sample 400 of drives." in plain.message
    assert parted.message == plain.message


def test_sample_weights_have_groups_of_their_own(tmp_path):
    text = FEW + 'regions = [{ where = "n > 3000", weight = 4.0 }]\n' + OFF + "max_iterations = 2\n"
    path = write_few(tmp_path, text)
    plain, parted = Project.read(path).calibrate(), in_partitions(path, 150).calibrate()
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-7)
    assert_same_trust(plain.trust, parted.trust)
    assert len(parted.trust.estimate.groups) == len(plain.trust.estimate.groups) == 2


@pytest.mark.slow
def test_results_do_not_depend_on_cached_entries(tmp_path):
    path = write_few(tmp_path, FEW + OFF + "max_iterations = 1\n")
    first = in_partitions(path, 150).calibrate()
    again = in_partitions(path, 150).calibrate()
    assert again.cost_after == first.cost_after
    assert all(np.array_equal(again.parameters[n].values, first.parameters[n].values) for n in first.parameters)


@pytest.mark.slow
def test_a_damaged_entry_is_prepared_again(tmp_path):
    path = write_few(tmp_path)
    first = CompiledProblem(in_partitions(path, 150).problem()).sums
    values = CompiledProblem(Project.read(path).problem()).start
    cost = first.cost(values)
    for entry in (tmp_path / ".kennfeld" / "partitions").glob(f"*{ENDING}"):
        entry.write_bytes(entry.read_bytes()[:-50])
    assert CompiledProblem(in_partitions(path, 150).problem()).sums.cost(values) == cost


@pytest.mark.slow
def test_a_flipped_bit_in_an_entry_is_noticed(tmp_path, monkeypatch):
    path = write_few(tmp_path)
    values = CompiledProblem(Project.read(path).problem()).start
    cost = CompiledProblem(in_partitions(path, 150).problem()).sums.cost(values)
    for entry in (tmp_path / ".kennfeld" / "partitions").glob(f"*{ENDING}"):
        content = bytearray(entry.read_bytes())
        content[len(content) // 3] ^= 0x40
        entry.write_bytes(content)
    monkeypatch.setattr(column_file, "_checked", {})  # as in another process
    assert CompiledProblem(in_partitions(path, 150).problem()).sums.cost(values) == cost


@pytest.mark.slow
def test_a_recording_of_the_same_size_and_time_counts_as_changed(tmp_path):
    path = write_few(tmp_path)
    file = tmp_path / "bench_0.csv"
    os.utime(file, ns=(10**18, 10**18))
    before = in_partitions(path, 150).problem().datasets[0]["torque"].values[1]
    text = file.read_text(encoding="utf-8")
    row = text.splitlines()[2]
    file.write_text(text.replace(row, row[:-1] + ("1" if row[-1] != "1" else "2")), encoding="utf-8")
    os.utime(file, ns=(10**18, 10**18))
    assert in_partitions(path, 150).problem().datasets[0]["torque"].values[1] != before


def test_another_version_of_the_package_prepares_entries_again(tmp_path, monkeypatch):
    path = write_few(tmp_path)
    in_partitions(path, 150).problem()
    folder = tmp_path / ".kennfeld" / "partitions"
    before = {entry.name for entry in folder.glob(f"*{ENDING}")}
    monkeypatch.setattr(prepared_files, "code_digest", lambda: "another")
    shared_content.cache_clear()  # as in another process
    in_partitions(path, 150).problem()
    after = {entry.name for entry in folder.glob(f"*{ENDING}")}
    assert before < after
    assert len(after) == 2 * len(before)


@pytest.mark.slow
def test_a_full_disk_keeps_no_entry_and_does_not_change_sums(tmp_path, monkeypatch):
    path = write_few(tmp_path)
    values = CompiledProblem(Project.read(path).problem()).start
    cost = CompiledProblem(in_partitions(path, 150).problem()).sums.cost(values)
    for entry in (tmp_path / ".kennfeld" / "partitions").glob(f"*{ENDING}"):
        entry.unlink()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(prepared_files, "write_columns", fail)
    assert CompiledProblem(in_partitions(path, 150).problem()).sums.cost(values) == cost
    assert not list((tmp_path / ".kennfeld" / "partitions").glob(f"*{ENDING}"))


@pytest.mark.slow
def test_four_processes_that_prepare_the_same_files_read_the_same_entries(tmp_path):
    path = write_few(tmp_path)
    values = CompiledProblem(Project.read(path).problem()).start
    cost = CompiledProblem(Project.read(path).problem()).sums.cost(values)
    with ThreadPoolExecutor(4) as threads:
        problems = list(threads.map(lambda _: in_partitions(path, 150).problem(), range(4)))
    costs = [CompiledProblem(problem).sums.cost(values) for problem in problems]
    assert len(set(costs)) == 1
    assert costs[0] == pytest.approx(cost, rel=1e-12)
    assert [entry.name for entry in (tmp_path / ".kennfeld" / "partitions").glob(".*") if entry.suffix == ENDING] == []


def test_the_folder_is_ignored_by_git(tmp_path):
    in_partitions(write_steady(tmp_path), 300).problem()
    assert (tmp_path / ".kennfeld" / "partitions" / ".gitignore").read_text() == "*\n"


def test_a_changed_file_is_read_again(tmp_path):
    path = write_steady(tmp_path)
    before = in_partitions(path, 300).problem().partitions.samples
    lines = (tmp_path / "bench_0.csv").read_text().splitlines()
    (tmp_path / "bench_0.csv").write_text("\n".join(lines[:100]))
    assert in_partitions(path, 300).problem().partitions.samples == before - (len(lines) - 100)


def test_partitions_follow_files_and_lengths(tmp_path):
    path = write_steady(tmp_path, samples=320)
    partitions = in_partitions(path, 400).problem().partitions
    assert [p.samples for p in partitions.training] == [320, 400, 10]
    assert [p.samples for p in partitions.test] == [400, 100]


def test_pieces_are_not_divided_for_a_model_with_memory(tmp_path):
    partitions = in_partitions(write_timed(tmp_path), 100).problem().partitions
    assert [p.samples for p in partitions.training] == [400, 450, 500]


def test_a_warmup_begins_only_with_pieces(tmp_path):
    path = write_timed(tmp_path)
    (tmp_path / "lag.kf").write_text("input u\nLagged = K(u) * T\n")
    plain, parted = (CompiledProblem(each.problem()) for each in (Project.read(path), in_partitions(path, 300)))
    assert parted.residuals == plain.residuals == 1260
    assert parted.sums.cost(plain.start) == pytest.approx(plain.sums.cost(plain.start))


@pytest.mark.parametrize("rounding", mostly_slow(["", ", round = false"], [""]))
def test_quantiles_are_those_of_all_data(tmp_path, rounding):
    path = write_steady(tmp_path, text=STEADY.replace("count = 6 }", f"count = 6{rounding} }}"))
    plain, parted = Project.read(path), in_partitions(path, 300)
    axes = [project.problem().parameters["M"].axes for project in (plain, parted)]
    for axis, other in zip(*axes, strict=True):
        assert np.array_equal(other.breakpoints, axis.breakpoints)
    remarks = [[f.message for f in project.check() if "rounded" in f.message] for project in (plain, parted)]
    assert remarks[0] == remarks[1]
    assert len(remarks[0]) == (2 if rounding else 3)


def test_values_without_data_are_locked_as_without_partitions(tmp_path):
    axis = 'x = { input = "n", begin = 0, end = 9000, count = 9 }'
    path = write_steady(tmp_path, text=STEADY.replace('x = { input = "n", count = 6 }', axis))
    plain, parted = Project.read(path).problem(), in_partitions(path, 300).problem()
    assert plain.parameters["M"].locked.any()
    assert np.array_equal(parted.parameters["M"].locked, plain.parameters["M"].locked)


def test_smoothed_lookups_use_samples_of_all_partitions(tmp_path):
    plain, parted = compiled_pair(tmp_path, write_steady, 300)
    expected, other = (Continuation.of(compiled)._smooth for compiled in (plain, parted))
    for form in (expected, other):
        form.set_width(0.5)
    assert close(other.sums.cost(plain.start), expected.sums.cost(plain.start))


def test_searches_are_compared_with_samples_of_all_partitions(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled_form, "SEARCH_SAMPLES", 300)
    monkeypatch.setattr(compiled_form, "SAMPLES_PER_VALUE", 0)
    path = write_steady(tmp_path, files=2, samples=500, text=FEW + OFF)
    parted = CompiledProblem(in_partitions(path, 400).problem())
    thinned = parted.thinned()
    assert thinned.samples.count == thinned.sample_count
    assert thinned.samples.count == pytest.approx(300, rel=0.1)  # fewer, as only scored samples are laid out
    assert thinned.weights == pytest.approx(parted.weights, rel=0.05)
    assert thinned.sums.cost(parted.start) == pytest.approx(parted.sums.cost(parted.start), rel=0.2)
    assert parted.with_start(parted.problem).thinned().samples is thinned.samples
    assert Continuation.of(parted)._smooth.samples.count == thinned.samples.count


@pytest.mark.slow
def test_a_search_on_some_samples_of_partitions_ends_like_one_without(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled_form, "SEARCH_SAMPLES", 300)
    monkeypatch.setattr(compiled_form, "SAMPLES_PER_VALUE", 0)
    path = write_steady(tmp_path, files=2, samples=500, text=FEW + OFF)
    result = in_partitions(path, 400).calibrate()
    assert result.converged
    assert result.cost_after == pytest.approx(Project.read(path).calibrate().cost_after, rel=1e-2)


@pytest.mark.slow
def test_the_best_step_of_a_search_is_one_on_all_samples(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled_form, "SEARCH_SAMPLES", 60)
    monkeypatch.setattr(compiled_form, "SAMPLES_PER_VALUE", 0)
    project = in_partitions(write_few(tmp_path), 150)
    run = FitRun(project.problem(), project.options, None, Seconds(0.0, 0.0, 0.0, 0.0))
    result = run.result()
    cost, values = run.best
    assert cost == pytest.approx(run.objective.cost(values), rel=1e-12)
    assert result.cost_after == pytest.approx(cost, rel=1e-6)


@pytest.mark.slow
def test_several_starts_and_steps_run_in_partitions(tmp_path):
    path = write_few(tmp_path, f"{FEW}\n[[step]]\ngrid_reduction = 2\n[[step]]\n{OFF}starts = 2\nmax_iterations = 3\n")
    plain, parted = Project.read(path).calibrate(workers=1), in_partitions(path, 150).calibrate()
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-5)
    assert len(parted.starts) == 2


@pytest.mark.slow
def test_the_excerpt_has_the_extremes_of_every_channel(tmp_path, monkeypatch):
    monkeypatch.setattr(partitioned_loading, "EXCERPT", 300)
    path = write_steady(tmp_path)
    data = in_partitions(path, 300).problem().datasets[0]
    whole = Project.read(path).problem().datasets[0]
    assert data.samples < whole.samples
    for name in whole:
        assert np.nanmax(data[name].values) == np.nanmax(whole[name].values)
        assert np.nanmin(data[name].values) == np.nanmin(whole[name].values)


@pytest.mark.slow
def test_a_condition_may_exclude_all_samples_of_a_file(tmp_path):
    path = write_steady(
        tmp_path, text=STEADY.replace('files = ["bench_*.csv"]', 'files = ["bench_*.csv"]\nwhere = "n > 3000"')
    )
    lines = (tmp_path / "bench_1.csv").read_text().splitlines()
    slow = [line for line in lines[1:] if float(line.split(",")[0]) < 3000]
    (tmp_path / "bench_1.csv").write_text("\n".join([lines[0], *slow]))
    plain, parted = Project.read(path), in_partitions(path, 300)
    assert not [finding for finding in parted.check() if finding.severity == "error"]
    values = CompiledProblem(plain.problem()).start
    assert CompiledProblem(parted.problem()).sums.cost(values) == pytest.approx(
        CompiledProblem(plain.problem()).sums.cost(values), rel=1e-12
    )


def test_a_condition_that_no_sample_meets_is_an_error(tmp_path):
    path = write_steady(
        tmp_path, text=STEADY.replace('files = ["bench_*.csv"]', 'files = ["bench_*.csv"]\nwhere = "n > 9000"')
    )
    messages = [str(finding) for finding in in_partitions(path, 300).check()]
    assert any("n > 9000 is true at no sample" in message for message in messages)


def test_a_missing_channel_names_the_files(tmp_path):
    path = write_steady(tmp_path, files=3)
    for number in (1, 2):
        file = tmp_path / f"bench_{number}.csv"
        file.write_text(file.read_text().replace("n,rl,zw", "n,rl,other"))
    messages = [str(finding) for finding in in_partitions(path, 300).check() if finding.severity == "error"]
    assert any(message.startswith("bench_1.csv and 1 more file: has no channel zw") for message in messages)


@pytest.mark.slow
def test_units_of_all_files_are_those_of_the_first(tmp_path):
    path = write_steady(tmp_path, files=2)
    (tmp_path / "torque.kf").write_text("TorqueModel = M(n, rl) * C(zw)\n")
    first = tmp_path / "bench_0.csv"
    first.write_text(first.read_text().replace("n,rl,zw,torque", "n[rpm],rl,zw,torque"))
    second = tmp_path / "bench_1.csv"
    lines = second.read_text().splitlines()[1:]
    rows = (f"{float(line.split(',')[0]) / 60:.10g},{line.split(',', 1)[1]}" for line in lines)
    second.write_text("\n".join(["n[rev/s],rl,zw,torque", *rows]))
    plain, parted = Project.read(path), in_partitions(path, 300)
    values = CompiledProblem(plain.problem()).start
    assert CompiledProblem(parted.problem()).sums.cost(values) == pytest.approx(
        CompiledProblem(plain.problem()).sums.cost(values), rel=1e-9
    )


@pytest.mark.slow
def test_files_of_an_object_store_are_copied_to_the_process_that_reads_them(tmp_path):
    fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed")
    path = write_few(tmp_path)
    store = fsspec.filesystem("memory")
    for file in tmp_path.glob("bench_*.csv"):
        store.pipe(f"/fleet/{file.name}", file.read_bytes())
    local = in_partitions(path, 150)
    path.write_text(path.read_text().replace("bench_*.csv", "memory://fleet/bench_*.csv"))
    remote = in_partitions(path, 150)
    values = CompiledProblem(local.problem()).start
    assert CompiledProblem(remote.problem()).sums.cost(values) == CompiledProblem(local.problem()).sums.cost(values)


def test_the_folder_of_prepared_files_stays_within_its_size(tmp_path):
    path = write_few(tmp_path)
    whole = in_partitions(path, 150)
    compiled = CompiledProblem(whole.problem())
    cost = compiled.sums.cost(compiled.start)
    small = in_partitions(path, 150, folder="small", folder_size=1e-5)
    assert CompiledProblem(small.problem()).sums.cost(compiled.start) == cost
    sizes = [entry.stat().st_size for entry in (tmp_path / "small").glob(f"*{ENDING}")]
    assert 0 < sum(sizes) <= max(10_000, max(sizes))


@pytest.mark.slow
def test_the_weight_of_a_dataset_is_not_a_reason_to_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(file_state, "SETTLED", -1)  # as if the files were two seconds old
    path = write_steady(tmp_path)
    first = in_partitions(path, 300)
    sums = CompiledProblem(first.problem()).sums
    values = CompiledProblem(first.problem()).start
    cost = sums.cost(values)
    entries = set((tmp_path / ".kennfeld" / "partitions").iterdir())
    datasets = tuple(replace(entry, weight=3.0) for entry in first.file.datasets)
    heavier = replace(in_partitions(path, 300), file=replace(first.file, datasets=datasets))
    assert CompiledProblem(heavier.problem()).sums.cost(values) == pytest.approx(3 * cost, rel=1e-12)
    assert entries == set((tmp_path / ".kennfeld" / "partitions").iterdir())


@pytest.mark.slow
def test_folds_hold_out_partitions(tmp_path):
    parted = in_partitions(write_few(tmp_path, FEW + OFF + "max_iterations = 4\n"), 150)
    validation = cross_validate(parted.problem(), folds=2, options=parted.options)
    rows = {row.fold: row for row in validation.folds}
    lines = [line for file in tmp_path.glob("bench_*.csv") for line in file.read_text().splitlines()[1:]]
    assert sum(row.samples for row in rows.values()) == sum(not line.endswith(",") for line in lines)
    assert 0.9 < validation.mean("TorqueModel") < 1.5


def test_folds_that_divide_files_are_an_error(tmp_path):
    problem = in_partitions(write_steady(tmp_path), 300).problem()
    with pytest.raises(InputError, match="data in partitions cannot be held out by random"):
        cross_validate(problem, kind="random")
    with pytest.raises(InputError, match="cannot make 50 folds of 4 partitions"):
        cross_validate(problem, folds=50)


def test_a_simulation_of_partitions_in_memory_is_an_error(tmp_path):
    with pytest.raises(InputError, match="data in partitions are not simulated as a whole"):
        in_partitions(write_steady(tmp_path), 300).simulate()


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("size", SIZES)
def test_a_simulation_is_that_of_all_data(tmp_path, write, size):
    path = write(tmp_path)
    simulations = [project.simulation() for project in (Project.read(path), in_partitions(path, size))]
    files = [write_simulation(each, tmp_path / f"{i}.parquet") for i, each in enumerate(simulations)]
    plain, parted = (parquet.read_table(file) for file in files)
    assert simulations[1].samples == simulations[0].samples
    assert parted.schema.equals(plain.schema, check_metadata=True)
    assert parted.num_rows == plain.num_rows > 1000
    assert parted.to_pydict() == plain.to_pydict()


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("size", SIZES)
def test_errors_by_recording_are_those_of_all_data(tmp_path, write, size):
    path = write(tmp_path)
    plain, parted = (project.problem() for project in (Project.read(path), in_partitions(path, size)))
    start = plain.parameters
    end = start.with_parameters(*(start[name].with_values(1.1 * start[name].values) for name in start))
    rows, others = (Scorer(problem).scores(start, end).recordings for problem in (plain, parted))
    names = [row.file for row in rows]
    assert names == sorted(names)
    assert len(set(names)) == len(names) >= 3
    for row, other in zip(rows, others, strict=True):
        assert (other.dataset, other.file, other.use, other.samples) == (row.dataset, row.file, row.use, row.samples)
        for name in ("rmse_before", "rmse_after", "max_abs_after"):
            assert getattr(other, name) == pytest.approx(getattr(row, name), rel=1e-12)
        assert vars(other.worst) == vars(row.worst) | {"rmse": pytest.approx(row.worst.rmse, rel=1e-12)}
        assert row.worst.rmse >= 0.9 * row.rmse_after


@pytest.mark.parametrize("pause", [150, 180])
def test_a_simulation_continues_divided_pieces(tmp_path, pause):
    text = "y = a * u\n"
    (tmp_path / "model.kf").write_text(text)
    rows = "\n".join(f"{0.1 * k + (50 if k >= pause else 0):g},{k}" for k in range(400))
    (tmp_path / "drive_1.csv").write_text(f"time [s],u [-]\n{rows}\n")
    (tmp_path / "drive_2.csv").write_text("time [s],u [-]\n" + "\n".join(f"{0.1 * k:g},{k}" for k in range(120)) + "\n")
    project = tmp_path / "kennfeld.toml"
    project.write_text(
        '[model]\nfile = "model.kf"\n[[dataset]]\nname = "d"\nfiles = ["drive_*.csv"]\n'
        '[parameters.a]\ninitial = 1.0\n[[criterion]]\nnode = "y"\ntarget = { channel = "u" }\n'
    )
    pieces = []
    for number, opened in enumerate([Project.read(project), in_partitions(project, 90)]):
        file = write_simulation(opened.simulation(), tmp_path / f"{number}.parquet")
        pieces.append(parquet.read_table(file)["piece"].to_pylist())
    assert pieces[0] == [1] * pause + [2] * (400 - pause) + [3] * 120
    assert pieces[1] == pieces[0]


@pytest.fixture
def few_recordings(monkeypatch):
    monkeypatch.setattr(compiled_form, "SEARCH_PIECE_SAMPLES", 300)
    monkeypatch.setattr(compiled_form, "SEARCH_PIECES", 4)


def write_many(folder, text=TIMED):
    return write_timed(folder, files=10, samples=80, text=text, growth=10)


@pytest.mark.slow
def test_a_search_of_a_model_with_memory_begins_with_the_recordings_of_one_without_partitions(tmp_path, few_recordings):
    path = write_many(tmp_path)
    plain, parted = (CompiledProblem(p.problem()) for p in (Project.read(path), in_partitions(path, 600)))
    expected, other = plain.thinned(), parted.thinned()
    assert other.problem.partitions.samples == sum(piece.last - piece.first for piece in expected.samples.pieces)
    assert 2 * other.problem.partitions.samples < parted.problem.partitions.samples
    values = plain.start * 1.05
    assert close(other.sums.cost(values), expected.sums.cost(values))
    assert close(other.sums.normal(values).matrix, expected.sums.normal(values).matrix)
    assert other.weights == pytest.approx(parted.weights, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("size", [300, pytest.param(5000, marks=pytest.mark.slow)])
def test_a_search_that_begins_with_some_recordings_ends_on_all_samples(tmp_path, few_recordings, size):
    path = write_many(tmp_path)
    plain, parted = Project.read(path).calibrate(), in_partitions(path, size).calibrate()
    assert parted.converged
    assert list(dict.fromkeys(line.stage for line in parted.trace)) == ["plain", "final"]
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-4)
    for name in plain.parameters:
        assert parted.parameters[name].values == pytest.approx(plain.parameters[name].values, rel=1e-2, abs=1e-2)


@pytest.mark.slow
def test_smoothed_lookups_of_a_model_with_memory_use_the_same_recordings(tmp_path, few_recordings):
    path = write_many(tmp_path, TIMED + "\n[optimizer]\nmax_iterations = 2\n")
    (tmp_path / "lag.kf").write_text("input u\nLagged = K(PT1(u, T))\n")
    plain, parted = (CompiledProblem(p.problem()) for p in (Project.read(path), in_partitions(path, 600)))
    expected, other = (Continuation.of(compiled) for compiled in (plain, parted))
    assert expected.thinned
    assert other.thinned
    for form in (expected._smooth, other._smooth):
        form.set_width(0.5)
    assert close(other._smooth.sums.cost(plain.start), expected._smooth.sums.cost(plain.start))
    again = other.with_start(parted.with_start(parted.problem))
    assert again._smooth.problem.partitions is other._smooth.problem.partitions


@pytest.mark.slow
def test_a_search_with_smoothed_lookups_and_memory_runs_in_partitions(tmp_path, few_recordings):
    path = write_many(tmp_path, TIMED + "\n[optimizer]\nmax_iterations = 2\n")
    (tmp_path / "lag.kf").write_text("input u\nLagged = K(PT1(u, T))\n")
    result = in_partitions(path, 600).calibrate()
    assert {"smooth 1", "final"} <= {line.stage for line in result.trace}
    assert result.cost_after < result.cost_before


@pytest.mark.slow
def test_starts_of_a_search_begin_with_the_same_recordings(tmp_path, few_recordings):
    path = write_many(tmp_path, TIMED + "\n[optimizer]\nstarts = 2\n")
    result = in_partitions(path, 600).calibrate()
    assert result.converged
    assert [row.status for row in result.starts] == ["converged", "converged"]
    assert {(line.start, line.stage) for line in result.trace} == {
        (1, "plain"),
        (1, "final"),
        (2, "plain"),
        (2, "final"),
    }


@pytest.mark.slow
def test_recordings_have_the_same_weight_without_cached_entries(tmp_path, few_recordings, monkeypatch):
    path = write_many(tmp_path)
    costs = []
    for _ in range(2):
        compiled = CompiledProblem(in_partitions(path, 600).problem())
        thinned = compiled.thinned()
        assert thinned is not compiled
        costs.append(thinned.sums.cost(thinned.start))
        monkeypatch.setattr(PreparedFiles, "keep", lambda *_: False)
        for entry in (tmp_path / ".kennfeld" / "partitions").glob(f"*{ENDING}"):
            entry.unlink()
    assert costs[1] == costs[0]
