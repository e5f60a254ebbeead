"""Projects that name data-driven models: what a run says where it leaves the data they were trained on."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.analysis.extrapolation import find_extrapolation
from kennfeld.domain.rbf import Expansion
from kennfeld.project import Project, partitioned_loading
from kennfeld.report import document, from_folder
from kennfeld.surrogate import (
    DynamicSurrogate,
    FilteredSurrogate,
    StaticSurrogate,
    SurrogateQuality,
    Validity,
    write_surrogate,
)
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty
from kennfeld.surrogate.uncertainty import Uncertainty


def bench_model(name="bench", validity=True):
    trained = np.random.default_rng(0).uniform([1000, 10], [3000, 14], (300, 2))
    expansion = Expansion(5.0, [0.001, 0.5], [3.0], [[2000.0, 12.0]], [[600.0, 2.0]])
    range_ = Validity.around(trained, trained.std(0)) if validity else None
    return StaticSurrogate(name, ("Speed", "Load"), "Torque", ("rpm", "", "Nm"), expansion, range_)


@pytest.fixture
def inside(shop):
    """A project whose function adds an offset to a surrogate, all within the data of that."""
    write_surrogate(bench_model("trained"), shop.folder / "bench.json")
    shop.text = (
        "input Speed[rpm]\ninput Load\nscalar offset\nscalar shift\nPredict[Nm] = bench(Speed, Load + shift) + offset\n"
    )
    shop.change('initial = "start.json"', 'free = ["offset"]')
    shop.add('[surrogates]\nbench = "bench.json"\n[parameters.offset]\ninitial = 0\n[parameters.shift]\ninitial = 0')
    return shop


@pytest.fixture
def outside(inside):
    """The same, and test data of which two samples are far out."""
    inside.bench("fast.csv", speed=(2000, 7000, 2500, 6000))
    return inside.add('[[dataset]]\nfiles = ["fast.csv"]\nuse = "test"')


def uncertain_model():
    model = bench_model("trained")
    return replace(model, uncertainty=Uncertainty(4.0, 0.5, [0.01]))


@pytest.mark.parametrize("partitions", [False, True])
def test_a_simulation_has_a_column_with_the_deviation_if_asked(outside, monkeypatch, partitions):
    write_surrogate(uncertain_model(), outside.folder / "bench.json")
    if partitions:
        monkeypatch.setattr(partitioned_loading, "EXCERPT", 1)
        monkeypatch.setattr(partitioned_loading, "LEAST_EXCERPT", 1)
        outside.add("[cluster]\npartition = 3")
    file = outside.folder / "s.csv"
    for options in ([], ["--deviation"]):
        assert cli.run(["simulate", str(outside.path), "-o", str(file), *options]) == 0
        with file.open(encoding="utf-8", newline="") as text:
            table = list(csv.DictReader(text))
        columns = [name for name in table[0] if name.startswith("bench (deviation)")]
        assert len(columns) == len(options)
    deviations = {use: [float(row[columns[0]]) for row in table if row["dataset"] == use] for use in ("bench", "fast")}
    assert {use: len(column) for use, column in deviations.items()} == {"bench": 6, "fast": 4}
    points = np.column_stack([[2000, 7000, 2500, 6000], [10, 11, 12, 13]])
    np.testing.assert_allclose(deviations["fast"], uncertain_model().deviation(points), rtol=1e-12)


@pytest.mark.parametrize("lags", [(), (1,), (2,), (1, 3)])  # of the output; none of a filtered model
def test_the_deviation_of_a_dynamic_surrogate_restarts_with_each_piece(tmp_path, lags):
    u = np.random.default_rng(0).normal(size=(40, 1))
    if not lags:
        expansion = Expansion(0.0, [0.0, 1.0], [1.0], [[0.0, 0.0]], [[1.0, 1.0]])
        model = FilteredSurrogate(
            "tank", ("u",), "y", 1.0, (3.0,), expansion, uncertainty=Uncertainty(0.2, 0.1, [0.01])
        )
    else:
        slopes = [*(0.9 / len(lags) for _ in lags), 0.3]
        expansion = Expansion(0.0, slopes, [1.0], np.zeros((1, len(slopes))), np.ones((1, len(slopes))))
        uncertainty = FreeRunUncertainty(0.2, 0.1, 0.05, 2.0)
        model = DynamicSurrogate("tank", ("u",), ((0,),), "y", lags, 1.0, expansion, uncertainty=uncertainty)
    pieces = [model.deviation(part) for part in (u[:15], u[15:])]
    write_surrogate(model, tmp_path / "tank.json")
    time = [*range(15), *range(200, 225)]
    rows = [f"{t},{value!r},0" for t, value in zip(time, u[:, 0].tolist(), strict=True)]
    (tmp_path / "data.csv").write_text("\n".join(["time,u,y", *rows]), encoding="utf-8")
    (tmp_path / "model.kf").write_text("input u\nscalar gain\ny_s = gain * tank(u)\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    parts = Project.read(tmp_path / "kennfeld.toml").simulation(deviation=True).parts()
    column = np.concatenate([part.data["tank (deviation)"].values for part in parts])
    np.testing.assert_allclose(column, np.concatenate(pieces), rtol=1e-12)


PROJECT = """
[model]
file = "model.kf"
[surrogates]
tank = "tank.json"
[parameters.gain]
initial = 1
[[criterion]]
node = "y_s"
target = { channel = "y" }
[[dataset]]
files = ["data.csv"]
raster = 1
"""

SENTENCE = (
    "bench is used outside its training data at 2 of 4 samples of fast (50 %), "
    "worst at sample 2, where Speed is 7000, above 2"
)


def result_of(shop):
    return json.loads((shop.folder / "results" / "result.json").read_text(encoding="utf-8"))


def test_data_in_partitions_extrapolate_a_surrogate_at_the_same_samples(outside, monkeypatch):
    whole = Project.read(outside.path)
    rows = find_extrapolation(whole.problem(), whole.problem().parameters)
    monkeypatch.setattr(partitioned_loading, "EXCERPT", 1)
    monkeypatch.setattr(partitioned_loading, "LEAST_EXCERPT", 1)
    parted = Project.read(outside.add("[cluster]\npartition = 3").path).problem()
    assert sum(data.samples for data in parted.datasets) < sum(row.samples for row in rows)
    assert len(parted.partitions.training) > 1
    assert find_extrapolation(parted, parted.parameters) == rows


def test_a_calibration_reports_samples_beyond_the_data_of_a_surrogate(outside, capsys):
    assert cli.run(["calibrate", str(outside.path)]) == 0
    out = capsys.readouterr().out
    assert "Surrogate extrapolation:\n  " + SENTENCE in out
    bench, fast = result_of(outside)["surrogates"]
    assert (bench["name"], bench["dataset"], bench["use"], bench["samples"]) == ("bench", "bench", "training", 6)
    assert (bench["outside"], bench["worst"]) == (0, None)
    assert (fast["dataset"], fast["outside"], fast["worst"]["sample"], fast["worst"]["input"]) == (
        "fast",
        2,
        2,
        "Speed",
    )


def test_a_calibration_within_the_data_prints_no_warning(inside, capsys):
    assert cli.run(["calibrate", str(inside.path)]) == 0
    assert "leaves" not in capsys.readouterr().out
    assert [row["outside"] for row in result_of(inside)["surrogates"]] == [0]


def test_a_project_without_surrogates_has_no_such_key(shop, capsys):
    assert cli.run(["calibrate", str(shop.path)]) == 0
    assert "surrogates" not in result_of(shop)
    assert "surrogate" not in capsys.readouterr().out
    assert "leaving" not in document(shop.project)


def test_a_simulation_reports_extrapolation_with_its_own_parameters(inside, capsys):
    path = str(inside.path)
    assert cli.run(["simulate", path]) == 0
    assert "leaves" not in capsys.readouterr().out
    inside.write("far.json", '{"shift": {"kind": "scalar", "unit": "", "value": 50.0}}')
    assert cli.run(["simulate", path, "-p", str(inside.folder / "far.json")]) == 0
    out = capsys.readouterr().out
    assert "bench is used outside its training data at 6 of 6 samples of bench (100 %)" in out
    assert "where Load is 63, above 1" in out


def test_the_report_of_a_folder_lists_the_same_extrapolation(outside):
    assert cli.run(["calibrate", str(outside.path)]) == 0
    report = (outside.folder / "results" / "report.html").read_text(encoding="utf-8")
    again = from_folder(Project.read(outside.path), outside.folder / "results")
    for text in (report, again):
        assert f'<li class="warning">{SENTENCE}' in text
        assert "add training data from this range" in text
        assert "farthest outside its data" in text


def test_the_report_lists_the_errors_of_a_surrogate_and_of_the_plane(inside):
    lines = tuple(
        SurrogateQuality("rig", "test", mode, 12, rmse, 0.9, 3.0) for mode, rmse in (("static", 1.25), ("plane", 7.5))
    )
    write_surrogate(replace(bench_model("trained"), quality=lines), inside.folder / "bench.json")
    assert cli.run(["calibrate", str(inside.path)]) == 0
    report = (inside.folder / "results" / "report.html").read_text(encoding="utf-8")
    text = re.sub(r"(<[^>]+>)+", "|", report)
    assert re.search(r"bench\|+rig\|+test\|+static\|+12\|+1\.25", text)
    assert re.search(r"bench\|+rig\|+test\|+plane\|+12\|+7\.5", text)
    assert "bench: deviation of a new measurement: not known" in text


def test_a_simulation_warns_if_a_requested_deviation_is_unknown(inside, capsys):
    assert cli.run(["simulate", str(inside.path), "--deviation"]) == 0
    assert "surrogate bench: its deviation is not known, so no column is written." in capsys.readouterr().err
    assert cli.run(["simulate", str(inside.path)]) == 0
    assert "deviation" not in capsys.readouterr().err


def test_the_report_confirms_a_surrogate_within_its_data(inside):
    text = document(inside.project, inside.project.calibrate())
    assert "bench is used within its training data at all 6 samples." in text


def test_the_report_on_the_start_lists_extrapolation(outside):
    assert SENTENCE in document(outside.project)


def test_a_surrogate_without_a_range_is_noted_and_not_counted(inside, capsys):
    write_surrogate(bench_model(validity=False), inside.folder / "bench.json")
    assert cli.run(["calibrate", str(inside.path)]) == 0
    assert "leaves" not in capsys.readouterr().out
    assert result_of(inside)["surrogates"][0]["outside"] is None
    assert "bench has no validity range" in document(inside.project)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("max", "kennfeld.toml [surrogates] max: max is a built-in function. Use another name."),
        ('"my engine"', "invalid name 'my engine' in formula text"),
    ],
)
def test_a_name_that_no_formula_can_call_is_reported(inside, name, message):
    inside.change('bench = "bench.json"', f'bench = "bench.json"\n{name} = "bench.json"')
    assert any(message in error for error in inside.errors())
