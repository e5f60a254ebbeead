"""Calibrations over many recordings: results do not depend on how data are divided, and memory not on their number."""

import json
import re
import tracemalloc

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from kennfeld.base import threads
from kennfeld.base.errors import InputError
from kennfeld.preprocessing import bound_parts
from kennfeld.project import Project
from kennfeld.project.results import write
from kennfeld.report import page, strip_details

TIMED = """
[model]
file = "exhaust.kf"

[[dataset]]
name = "fleet"
files = ["drive_*.parquet"]
warmup = 2.0

[parameters.Settled]
x = { begin = 0, end = 10, count = 6 }
initial = 300.0
smoothness = 1e-3

[parameters.Lag]
x = { begin = 0, end = 10, count = 3 }
initial = 3.0
bounds = [0.1, 20]

[[criterion]]
node = "T"
target = { channel = "Measured" }
"""
LAG = "T[degC] = PT1(Settled(Load), Lag(Flow))\n"
STEADY = "T[degC] = Settled(Load) + 0 * Flow\n"


def drive(samples, seed):
    random = np.random.default_rng(seed)
    load = np.clip(5 + np.cumsum(random.normal(0, 0.1, samples)), 0, 10)
    settled = 200 + 40 * load
    measured = settled + random.normal(0, 2.0, samples)
    return {"time": 0.1 * np.arange(samples), "Load": load, "Flow": 10 - load, "Measured": measured}


def write_drives(folder, drives):
    for number, columns in enumerate(drives):
        path = folder / f"drive_{number:02d}.parquet"
        pyarrow.parquet.write_table(pyarrow.table(columns), path)


@pytest.fixture
def project(tmp_path):
    """Return a function that writes recordings with a project."""

    def create(name, drives, formula=LAG, text=TIMED):
        folder = tmp_path / name
        folder.mkdir()
        write_drives(folder, drives)
        (folder / "exhaust.kf").write_text(formula)
        (folder / "kennfeld.toml").write_text(text)
        return Project.read(folder / "kennfeld.toml")

    return create


def run(project):
    """Calibrate, report and write; return the result, the figures of the report and the simulation."""
    findings, result = project.check(), project.calibrate()
    text = page.document(project, result, findings)
    folder = project.path.parent / "results"
    write(result, project, folder)
    data = json.loads(re.search(r'id="report-data">(.*?)</script>', text, re.DOTALL)[1])
    return result, data["figures"], pyarrow.parquet.read_table(folder / "simulation.parquet")


def close(first, second):
    """Return whether two structures are equal, numbers but for rounding."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(close(first[key], second[key]) for key in first)
    if isinstance(first, list):
        return len(first) == len(second) and all(map(close, first, second))
    if isinstance(first, float):
        return first == pytest.approx(second, rel=1e-5, abs=1e-7)
    return first == second


@pytest.mark.parametrize(
    "formula", [pytest.param(LAG, id="memory"), pytest.param(STEADY, id="no memory", marks=pytest.mark.slow)]
)
def test_results_do_not_depend_on_the_size_of_parts(project, monkeypatch, formula):
    drives = [drive(samples, seed) for seed, samples in enumerate((700, 300, 500, 40, 900, 600))]
    drives[4]["Load"][100:130] = np.nan
    drives[2]["Measured"][50:300] = np.nan
    whole = run(project("whole", drives, formula))
    monkeypatch.setattr(bound_parts, "SAMPLES_PER_BLOCK", 400)
    parts = run(project("parts", drives, formula))
    (bound,) = parts[0].inspection.problem.training
    assert len(parts[0].inspection.problem.parts(bound)) >= 4
    assert close(whole[1], parts[1])
    np.testing.assert_allclose([q.rmse_after for q in parts[0].quality], [q.rmse_after for q in whole[0].quality])
    for name, deviation in whole[0].trust.deviation.items():
        np.testing.assert_allclose(parts[0].trust.deviation[name], deviation, rtol=1e-9)
    assert parts[2].equals(whole[2])


def test_points_may_lie_in_one_file_or_in_many(project):
    columns = drive(3000, 0)
    del columns["time"]
    split = [{name: values[at : at + 500] for name, values in columns.items()} for at in range(0, 3000, 500)]
    text = TIMED.replace("warmup = 2.0\n", "")
    (single, _, simulation), (several, _, others) = (
        run(project(name, drives, STEADY, text)) for name, drives in (("one", [columns]), ("several", split))
    )
    np.testing.assert_array_equal(single.parameters["Settled"].values, several.parameters["Settled"].values)
    assert single.cost_after == several.cost_after
    assert vars(single.quality[0]) == vars(several.quality[0])
    assert others.drop_columns(["file", "piece"]).equals(simulation.drop_columns(["file", "piece"]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("use", "samples", "files"),
    [(Project.calibrate, 10_000, 20), pytest.param(run, 20_000, 30, marks=pytest.mark.slow)],
    ids=["calibration", "all"],
)
def test_memory_is_that_of_the_data(project, monkeypatch, use, samples, files):
    """Beside the channels and their time there is a copy of the target for the search, and room for a few parts."""
    monkeypatch.setattr(threads, "available_cores", lambda: 2)  # each core has a part of its own
    monkeypatch.setattr(strip_details, "TOTAL_NUMBERS", 30_000)  # the room of a page does not grow with the data
    monkeypatch.setattr(bound_parts, "SAMPLES_PER_BLOCK", samples)
    drives = [drive(samples, seed) for seed in range(files)]
    few, many = project("few", drives[:2]), project("many", drives)
    use(few)  # what is imported and compiled only once
    peaks = []
    for each in (Project.read(few.path), many):
        tracemalloc.start()
        use(each)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    data = 8 * samples * (files - 2) * 3  # Load, Flow and Measured in double precision
    assert peaks[1] - peaks[0] < 2 * data


def test_a_bad_file_among_many_is_named(project):
    drives = [drive(200, seed) for seed in range(9)]
    del drives[3]["Flow"]
    broken = project("broken", drives)
    (broken.path.parent / "drive_05.parquet").write_bytes(b"PAR1 nothing else")
    drives[7] = {**drives[7], "time": drives[7]["time"][::-1]}
    pyarrow.parquet.write_table(pyarrow.table(drives[7]), broken.path.parent / "drive_07.parquet")
    with pytest.raises(InputError) as caught:
        broken.problem()
    places = dict.fromkeys(str(finding.location).split()[0].rstrip(":,") for finding in caught.value.findings)
    assert list(places) == ["drive_05.parquet", "drive_07.parquet", "drive_03.parquet"]
