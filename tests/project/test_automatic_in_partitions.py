"""Smoothness factors and shifts that are chosen over partitions are those that are chosen over all data."""

import json
import re

import numpy as np
import pytest
from pyarrow import parquet

from kennfeld.analysis.cross_validation import cross_validate
from kennfeld.cli import run
from kennfeld.optimize.problem import partitions as partitions_module
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning import shift_estimation
from kennfeld.optimize.tuning.holdout_blocks import BLOCKS, NEVER, HoldoutBlocks
from kennfeld.optimize.tuning.independent_samples import independent_samples
from kennfeld.optimize.tuning.shift_estimation import estimate_shifts
from kennfeld.preprocessing.prepared_files import ENDING
from kennfeld.project import Project
from kennfeld.project.results import write_simulation
from tests.draws import mostly_slow
from tests.project.partitioned_projects import (
    FEW,
    OFF,
    SHIFTED,
    TIMED,
    in_partitions,
    write_lasting,
    write_shifted,
    write_steady,
    write_timed,
)

AUTO = 'smoothness = "auto"'
LASTING = SHIFTED.replace('shift = { y = "auto" }\n', "").replace("smoothness = 1e-4", AUTO)
LASTING = LASTING.replace('[[dataset]]\nname = "road"\nfiles = ["road.csv"]\nuse = "test"\n', "")


def write_lasting_errors(folder):
    return write_lasting(folder, LASTING)


def write_automatic_drives(folder):
    return write_timed(folder, text=TIMED.replace("smoothness = 1e-4", AUTO))


def write_few_points(folder):
    text = FEW.replace("initial = 1.0\nsmoothness = 0.01", f"initial = 1.0\n{AUTO}") + OFF + "tolerance = 1e-10\n"
    return write_steady(folder, files=2, samples=150, text=text)


def write_few_drives(folder):
    text = TIMED.replace("smoothness = 1e-4", AUTO).replace("count = 5", "count = 4")
    return write_timed(folder, files=2, samples=200, text=text + OFF)


def write_few_lasting_errors(folder):
    return write_lasting(folder, LASTING.replace("count = 5", "count = 4"), files=2, samples=500)


def scan_a_part(monkeypatch, samples):
    """Scan lags on this many samples, so that the others count only when neighbouring lags are compared."""
    monkeypatch.setattr(shift_estimation, "SCANNED_SAMPLES", samples)
    monkeypatch.setattr(partitions_module, "LEAST_STRETCH", samples // 3)


@pytest.fixture(autouse=True)
def few_lags(request, monkeypatch):
    """Scan few lags around those of the recordings."""
    if request.node.get_closest_marker("slow") is None:
        monkeypatch.setattr(shift_estimation, "WINDOW", 6)


def pair(path, size):
    return Project.read(path), in_partitions(path, size)


def blocks_in(result):
    match = re.search(r"by (\d+) held-out blocks", result.message)
    return int(match[1]) if match else 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("write", "size", "blocks", "closeness"),
    [
        (write_few_points, 100, 0, 1e-5),
        (write_few_drives, 200, 20, 1e-5),
        (write_few_lasting_errors, 2500, 20, 1e-5),  # files are whole
        # pairs of errors are not counted across the cuts of files
        (write_lasting_errors, 700, 20, 0.01),
    ],
)
def test_the_choice_is_that_of_all_data(tmp_path, write, size, blocks, closeness):
    plain, parted = (project.calibrate() for project in pair(write(tmp_path), size))
    assert plain.status == parted.status == "converged"
    assert blocks_in(plain) == blocks_in(parted) == blocks
    for name, factors in plain.smoothness.items():
        for axis, factor in factors.items():
            assert parted.smoothness[name][axis] == pytest.approx(factor, rel=closeness)
    for row, other in zip(plain.quality, parted.quality, strict=True):
        assert other.rmse_after == pytest.approx(row.rmse_after, rel=0.01 * closeness)


@pytest.mark.slow
def test_a_step_chooses_its_factors_in_partitions(tmp_path):
    text = (
        FEW
        + f'\n[[step]]\ngrid_reduction = 2\n{AUTO}\n[[step]]\nsmoothness = {{ M = "auto" }}\n{OFF}max_iterations = 4\n'
    )
    path = write_steady(tmp_path, files=2, samples=120, text=text)
    plain, parted = (project.calibrate() for project in pair(path, 150))
    assert parted.smoothness.keys() == plain.smoothness.keys() == {"M", "C"}
    for name, factors in plain.smoothness.items():
        assert list(parted.smoothness[name].values()) == pytest.approx(list(factors.values()), rel=1e-4)
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-4)  # it follows the factors


@pytest.mark.parametrize("write", mostly_slow([write_lasting_errors, write_automatic_drives], [write_automatic_drives]))
@pytest.mark.parametrize("size", mostly_slow([150, 10**6], 1))
def test_blocks_are_those_of_all_data(tmp_path, write, size):
    """The block of a recording that is cut goes on in the next partition."""
    plain, parted = (CompiledProblem(project.problem()) for project in pair(write(tmp_path), size))
    plain_blocks, parted_blocks = HoldoutBlocks.of(plain), HoldoutBlocks.of(parted)
    assert plain_blocks.sizes.tolist() == parted_blocks.sizes.tolist()
    assert BLOCKS - 2 <= plain_blocks.sizes.size <= BLOCKS
    values = plain.start * 1.01
    for first, second in zip(plain_blocks.linearise(values), parted_blocks.linearise(values), strict=True):
        assert second.misfit == pytest.approx(first.misfit, rel=1e-10)
        assert second.share == first.share
        np.testing.assert_allclose(second.gradient, first.gradient, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(second.matrix, first.matrix, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_many_short_recordings_are_held_out_together_in_partitions(tmp_path):
    path = write_timed(tmp_path, files=12, samples=60, growth=5, text=TIMED.replace("smoothness = 1e-4", AUTO))
    plain, parted = (CompiledProblem(project.problem()) for project in pair(path, 300))
    plain_blocks, parted_blocks = HoldoutBlocks.of(plain), HoldoutBlocks.of(parted)
    assert (plain_blocks.numbers != NEVER).any()
    assert plain_blocks.sizes.tolist() == parted_blocks.sizes.tolist()
    for first, second in zip(plain_blocks.linearise(plain.start), parted_blocks.linearise(plain.start), strict=True):
        assert second.misfit == pytest.approx(first.misfit, rel=1e-10)


@pytest.mark.parametrize(("size", "closeness"), [(2500, 1e-12), (700, 0.15)])
def test_independent_samples_are_counted_over_all_partitions(tmp_path, size, closeness):
    plain, parted = (project.problem() for project in pair(write_lasting_errors(tmp_path), size))
    count = independent_samples(plain, plain.parameters)
    assert count < plain.datasets[0].samples / 10
    assert independent_samples(parted, parted.parameters) == pytest.approx(count, rel=closeness)


# the model, and the size of partitions: files of a function without memory are cut
@pytest.mark.parametrize(("model", "size"), [("memory", 150), pytest.param("none", 300, marks=pytest.mark.slow)])
def test_a_shift_scanned_on_all_samples_is_that_of_all_data(tmp_path, model, size):
    path = write_shifted(tmp_path, model, text=SHIFTED + OFF, files=2, samples=250)
    plain, parted = (project.calibrate() for project in pair(path, size))
    assert parted.shifts == plain.shifts
    assert parted.shifts["drives"]["y"] == pytest.approx(-0.34, abs=0.01)
    assert parted.message == plain.message
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-10)
    for row, other in zip(plain.quality, parted.quality, strict=True):
        assert (other.dataset, other.samples) == (row.dataset, row.samples)
        assert other.rmse_after == pytest.approx(row.rmse_after, rel=1e-8)
    assert parted.trust.noise["Y"] == pytest.approx(plain.trust.noise["Y"], rel=1e-3)


@pytest.mark.parametrize(
    ("model", "files", "samples", "size"),
    [
        ("none", 2, 250, 300),
        pytest.param("none", 4, 820, 300, marks=pytest.mark.slow),
        pytest.param("memory", 2, 250, 150, marks=pytest.mark.slow),
    ],
)
def test_a_shift_scanned_on_some_samples_is_refined_on_all(tmp_path, model, files, samples, size, monkeypatch):
    path = write_shifted(tmp_path, model, text=SHIFTED + OFF, files=files, samples=samples)
    plain = Project.read(path).calibrate()
    scan_a_part(monkeypatch, 900 if samples > 300 else 200)
    parted = in_partitions(path, size).calibrate()
    assert parted.shifts["drives"]["y"] == pytest.approx(plain.shifts["drives"]["y"], abs=1e-4)  # of 0.1 s
    assert parted.shifts["road"] == parted.shifts["drives"]
    training = sum(samples + 90 * number - 20 for number in range(files))
    assert re.search(
        rf"Shifts were scanned on \d+ of {training} training samples, and compared with their neighbours on all\.",
        parted.message,
    )
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-4)


@pytest.mark.slow
def test_the_fraction_of_a_sample_does_not_follow_the_part_that_is_scanned(tmp_path, monkeypatch):
    """One recording is half a sample later than the others: the estimate is between them, wherever lags are scanned."""
    path = write_shifted(tmp_path, "none")
    lines = (tmp_path / "drive_0.csv").read_text().splitlines()
    times = (f"{float(line.split(',')[0]):.2f},{line.split(',', 1)[1]}" for line in lines[1:])
    time, u, y = np.array([[float(x) for x in row.split(",")] for row in times]).T
    y = np.interp(time - 0.05, time, y)
    rows = (f"{a:.1f},{b:.8g},{c:.8g}" for a, b, c in zip(time, u, y, strict=True))
    (tmp_path / "drive_0.csv").write_text("\n".join(["time,u,y", *rows]))
    whole = Project.read(path).calibrate().shifts["drives"]["y"]
    scan_a_part(monkeypatch, 700)
    monkeypatch.setattr(partitions_module, "LEAST_STRETCH", 700)
    problem = in_partitions(path, 10_000).problem()
    assert estimate_shifts(problem)[1]["drives"]["y"] == pytest.approx(whole, abs=2e-3)


@pytest.mark.slow
def test_layouts_of_other_lags_do_not_stay_on_the_disk(tmp_path, monkeypatch):
    scan_a_part(monkeypatch, 200)
    path = write_shifted(tmp_path, files=2, samples=250)
    problem = in_partitions(path, 300).problem()
    folder = tmp_path / ".kennfeld" / "partitions"
    before = set(folder.glob(f"*{ENDING}"))
    estimate_shifts(problem)
    assert set(folder.glob(f"*{ENDING}")) == before


@pytest.mark.parametrize("model", mostly_slow(["memory", "none"], 1))
@pytest.mark.parametrize("size", mostly_slow([300, 500], 1))
def test_a_simulation_with_shifts_is_that_of_all_data(tmp_path, model, size):
    shifts = {"drives": {"y": -0.34, "u": 0.27}, "road": {"y": 0.2}}
    tables = []
    for number, project in enumerate(pair(write_shifted(tmp_path, model, files=2, samples=420), size)):
        file = write_simulation(project.simulation(None, shifts), tmp_path / f"{number}.parquet")
        tables.append(parquet.read_table(file))
    plain, parted = (table.to_pydict() for table in tables)
    assert plain.keys() == parted.keys()
    for name, values in plain.items():
        exact = name in ("dataset", "file", "piece", "use")
        close = np.testing.assert_array_equal if exact else np.testing.assert_allclose
        close(np.array(parted[name], dtype=None if exact else float), np.array(values, dtype=None if exact else float))


@pytest.mark.slow
def test_points_without_time_are_shifted_by_whole_samples(tmp_path, monkeypatch):
    path = write_shifted(tmp_path, "none", delay=3.0, text=SHIFTED + OFF, files=3, samples=400)
    for file in (*tmp_path.glob("drive_*.csv"), tmp_path / "road.csv"):
        file.write_text("\n".join(line.split(",", 1)[1] for line in file.read_text().splitlines()))
    scan_a_part(monkeypatch, 600)
    monkeypatch.setattr("kennfeld.project.partitioned_loading.EXCERPT", 400)
    plain, parted = (project.calibrate() for project in pair(path, 400))
    assert parted.shifts == plain.shifts == {"drives": {"y": -3.0}, "road": {"y": -3.0}}
    assert parted.cost_after == pytest.approx(plain.cost_after, rel=1e-8)


@pytest.mark.slow
def test_folds_of_partitions_estimate_their_own_shifts(tmp_path):
    text = SHIFTED.replace(
        '[[dataset]]\nname = "road"\nfiles = ["road.csv"]\nuse = "test"\nshift = { y = "auto" }\n', ""
    )
    project = in_partitions(write_shifted(tmp_path, text=text + OFF), 1000)
    validation = cross_validate(project.problem(), folds=2, options=project.options)
    assert validation.mean("Y") == pytest.approx(0.02, rel=0.1)  # without the shift, it is 0.24


def test_an_automatic_shift_that_cannot_be_estimated_is_reported(tmp_path):
    text = SHIFTED.replace('{ y = "auto" }', '{ z = "auto" }')
    messages = [str(finding) for finding in in_partitions(write_shifted(tmp_path, text=text), 1000).check()]
    assert any("channel z is not used" in message for message in messages)


@pytest.mark.slow
def test_the_command_writes_chosen_shifts_and_factors(tmp_path, capsys):
    text = SHIFTED.replace("smoothness = 1e-4", AUTO) + "\n[cluster]\npartition = 200\n"
    path = write_shifted(tmp_path, text=text + OFF, files=2, samples=250)
    assert run(["calibrate", str(path)]) == 0
    written = json.loads((tmp_path / "results" / "result.json").read_text())
    assert written["shifts"]["road"]["y"] == pytest.approx(-0.34, abs=0.01)
    assert written["smoothness"]["K"]["x"] > 0
    assert "shift of y in drives: -0.3" in capsys.readouterr().out


@pytest.mark.slow
def test_the_command_simulates_with_the_shifts_of_a_result(tmp_path, capsys):
    path = write_shifted(tmp_path)
    assert run(["calibrate", str(path)]) == 0
    whole = parquet.read_table(tmp_path / "results" / "simulation.parquet").to_pydict()
    path.write_text(path.read_text() + "\n[cluster]\npartition = 500\n")
    values = str(tmp_path / "results" / "parameters.json")
    assert run(["simulate", str(path), "-p", values]) == 0
    assert f"from {tmp_path / 'results' / 'result.json'}" in capsys.readouterr().out
    assert parquet.read_table(tmp_path / "simulation.parquet").to_pydict()["Y"] == whole["Y"]
    assert run(["simulate", str(path)]) == 0
    assert 'channels with shift = "auto" are not shifted' in capsys.readouterr().err
