import csv
import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from kennfeld import Axis, Curve, Dataset, InputError, Map, ParameterSet, Scalar, calibrate, read, read_parameters
from kennfeld.project.results import (
    COLUMNS,
    read_shifts,
    require_room,
    write,
    write_simulation,
    write_text,
    write_trust,
)
from tests.project.simulated_datasets import SimulatedDatasets

FILES = ["parameters.json", "parameters.dcm", "trace.csv", "trust.csv", "simulation.parquet", "result.json"]


class Line:
    """The part of a project that results need: formats, and a simulation of two datasets, one of them in time."""

    formats = (".dcm",)
    further_results = ()
    surrogates = ()
    is_partitioned = False

    def change_of_function(self, parameters, ending):
        return parameters

    def simulation(self, parameters=None, shifts=None):
        steady = Dataset.of("bench", {"y": [1.0, 2.0], "Torque": [1.5, np.nan]}, units={"y": "Nm"})
        moving = Dataset.of(
            "drive", {"y": [3.0, 4.0, 5.0]}, time=np.array([0.0, 0.1, 0.0]), piece_starts=np.array([0, 2])
        )
        return SimulatedDatasets(steady, moving)


@pytest.fixture(scope="module")
def result():
    return calibrate("y = a + b * x", {"x": [0.0, 1, 2], "t": [1.0, 3, 5]}, {"a": 0.0, "b": 0.0}, target="t")


def everything_in(folder):
    return {path.relative_to(folder): path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


def test_a_run_writes_exactly_the_documented_files(result, tmp_path):
    written = write(result, Line(), tmp_path / "deep" / "results")
    assert sorted(path.name for path in written) == sorted(FILES)
    assert sorted(path.name for path in (tmp_path / "deep" / "results").iterdir()) == sorted(FILES)


def test_the_result_has_its_documented_keys(result, tmp_path):
    write(result, Line(), tmp_path)
    contents = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert list(contents) == [
        *("status", "message", "iterations", "evaluations", "cost", "seconds", "values", "certificate", "quality"),
        *("recordings", "starts", "resumed", "trust", "smoothness", "shifts", "warnings", "files"),
    ]
    assert set(contents["cost"]) == {"before", "after"}
    assert set(contents["seconds"]) == {"total", "read", "compile", "optimize"}
    assert contents["values"] == {"free": 2, "fixed": 0}
    assert list(contents["quality"][0]) == [
        *("criterion", "dataset", "use", "samples", "rmse_before", "rmse_after", "r2_after", "max_abs_after"),
    ]


def test_the_parameters_are_written_in_every_format(result, tmp_path):
    write(result, Line(), tmp_path)
    for name in ("parameters.json", "parameters.dcm"):
        assert read_parameters(tmp_path / name)["b"].value == pytest.approx(2.0)


def test_the_trace_has_a_line_for_each_step(result, tmp_path):
    write(result, Line(), tmp_path)
    with (tmp_path / "trace.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        *("iteration", "start", "stage", "cost", "rmse", "step", "damping", "active", "seconds"),
    ]
    assert len(rows) == len(result.trace)
    assert float(rows[-1]["cost"]) == result.trace[-1].cost


def test_the_trust_has_a_line_for_each_free_value(tmp_path):
    table = Map("M", [0.0, 1.0, 2.0], Axis([0.0, 5.0], input="y"), np.ones((3, 2)), unit="Nm")
    start = ParameterSet([table, Scalar("k", 1.0), Curve("C", [0.0, 1.0], [0.0, 0.0])])
    rng = np.random.default_rng(0)
    columns = {"x": rng.uniform(0, 1, 50), "y": rng.uniform(0, 5, 50), "t": rng.normal(size=50)}
    text = "m = M(x, y) + k * x^2 * y + C(x)"
    fit = calibrate(text, columns, start, target="t", free=["M", "k"])
    write(fit, Line(), tmp_path)
    with (tmp_path / "trust.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert [row["parameter"] for row in rows] == ["M"] * 6 + ["k"]
    assert [(row["x"], row["y"], row["z"]) for row in rows[:2]] == [("0.0", "0.0", ""), ("0.0", "5.0", "")]
    assert rows[6]["x"] == ""
    assert [float(row["value"]) for row in rows[:6]] == fit.parameters["M"].values.ravel().tolist()
    deviation = [float(row["deviation"]) for row in rows[:6]]
    assert deviation == pytest.approx(fit.trust.deviation["M"].ravel(), rel=1e-5)
    assert deviation[4:] == [np.inf, np.inf]
    assert [int(row["samples"]) for row in rows[:6]] == fit.trust.samples["M"].ravel().tolist()
    assert [row["informed"] for row in rows[:6]] == ["1"] * 4 + ["0"] * 2
    assert rows[0]["unit"] == "Nm"
    trust = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["trust"]
    assert list(trust) == [
        *("noise", "persistence", "freedom", "undetermined", "by_smoothness"),
        *("null_space", "directions", "holdings", "remark"),
    ]
    assert trust["undetermined"] == 2
    assert list(trust["directions"][0]) == ["sentence", "remedy", "exact", "determined", "ratio", "parameters"]
    assert trust["directions"][0]["parameters"] == ["M"]


def test_only_names_and_pieces_of_a_simulation_have_a_dictionary(result, tmp_path):
    write(result, Line(), tmp_path)
    group = pyarrow.parquet.ParquetFile(tmp_path / "simulation.parquet").metadata.row_group(0)
    columns = [group.column(number) for number in range(group.num_columns)]
    repeated = [c.path_in_schema for c in columns if any("DICTIONARY" in encoding for encoding in c.encodings)]
    assert repeated == ["dataset", "file", "piece"]


def test_unknown_cells_of_the_trust_are_empty(tmp_path):
    two = calibrate("y = a + b * x", {"x": [0.0, 1], "t": [1.0, 3]}, {"a": 0.0, "b": 0.0}, target="t")
    write(two, Line(), tmp_path)
    with (tmp_path / "trust.csv").open(encoding="utf-8", newline="") as file:
        assert [row["deviation"] for row in csv.DictReader(file)] == ["", ""]


def test_the_simulation_contains_all_datasets_in_order(result, tmp_path):
    write(result, Line(), tmp_path)
    table = pyarrow.parquet.read_table(tmp_path / "simulation.parquet").to_pydict()
    assert table == {
        "dataset": ["bench", "bench", "drive", "drive", "drive"],
        "file": [None] * 5,
        "piece": [1, 1, 1, 1, 2],
        "time": [None, None, 0.0, 0.1, 0.0],
        "y": [1.0, 2.0, 3.0, 4.0, 5.0],
        "Torque": [1.5, None, None, None, None],
    }


def test_a_simulation_has_its_units(tmp_path):
    path = write_simulation(SimulatedDatasets(Line().simulation().datasets[0]), tmp_path / "simulation.parquet")
    assert read(path)["y"].unit == "Nm"


def test_a_simulation_can_be_csv(tmp_path):
    path = write_simulation(Line().simulation(), tmp_path / "simulation.csv")
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].replace('"', "") == "dataset,file,piece,time,y,Torque"
    assert lines[1].replace('"', "") == "bench,,1,,1,1.5"
    assert len(lines) == 6


@pytest.mark.parametrize("begin", ["=", "+", "-", "@"])
def test_no_cell_of_a_csv_file_is_a_formula(tmp_path, begin):
    name = f"{begin}cmd|' /C calc'!A0"
    data = Dataset.of(name, {name: [-1.0, 2.0]})
    path = write_simulation(SimulatedDatasets(data), tmp_path / "simulation.csv")
    scalar = Scalar(name, -1.0, unit=name)
    trust = calibrate("y = K * x", {"x": [1.0, 2.0], "t": [-1.0, -2.0]}, {"K": 1.0}, target="t").trust
    renamed = replace(
        trust,
        **{
            key: {name: getattr(trust, key)["K"]}
            for key in ("columns", "deviation", "scatter", "samples", "informed", "by_smoothness")
        },
    )
    write_trust(renamed, ParameterSet([scalar]), tmp_path / "trust.csv")
    for file in (path, tmp_path / "trust.csv"):
        with file.open(encoding="utf-8", newline="") as stream:
            cells = [cell for row in csv.reader(stream) for cell in row]
        assert f"'{name}" in cells
        formulas = [cell for cell in cells if cell.startswith(("=", "+", "-", "@"))]
        assert [float(cell) for cell in formulas]  # numbers stay numbers


def test_a_parquet_file_keeps_names_as_they_are(tmp_path):
    path = write_simulation(SimulatedDatasets(Dataset.of("=a", {"=b": [1.0]})), tmp_path / "simulation.parquet")
    table = pyarrow.parquet.read_table(path).to_pydict()
    assert (table["dataset"], table["=b"]) == (["=a"], [1.0])


def test_a_node_with_the_name_of_a_reserved_column_gets_another_name(tmp_path):
    path = write_simulation(
        SimulatedDatasets(Dataset.of("bench", {"piece": [7.0], "time": [8.0]})), tmp_path / "s.parquet"
    )
    table = pyarrow.parquet.read_table(path).to_pydict()
    assert (table["piece"], table["piece (model)"], table["time (model)"]) == ([1], [7.0], [8.0])


def test_a_simulation_with_an_unknown_ending_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"extension \.parquet, \.csv, \.mf4 or \.mat, got \.xlsx"):
        write_simulation(Line().simulation(), tmp_path / "s.xlsx")
    assert not list(tmp_path.iterdir())


def test_the_result_lists_the_files_of_its_run_with_their_hashes(result, tmp_path):
    write(result, Line(), tmp_path, {"report.html": "<p></p>"})
    files = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["files"]
    assert sorted(files) == sorted(set(FILES) - {"result.json"})
    for name, digest in files.items():
        assert digest == hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()


def test_documents_are_written_with_the_other_files(result, tmp_path):
    written = write(result, Line(), tmp_path, {"report.html": "<p>Öl</p>\n"})
    assert sorted(path.name for path in written) == sorted([*FILES, "report.html"])
    assert (tmp_path / "report.html").read_bytes() == "<p>Öl</p>\n".encode()


def test_a_text_is_written_into_a_new_folder(tmp_path):
    assert write_text("text", tmp_path / "deep" / "a.html").read_text(encoding="utf-8") == "text"
    assert everything_in(tmp_path) == {Path("deep/a.html"): b"text"}


@pytest.mark.skipif(os.name != "posix", reason="permissions and links as POSIX has them")
@pytest.mark.parametrize(
    "rewrite",
    [
        lambda path: write_text("text", path, follow=True),
        lambda path: write_simulation(Line().simulation(), path, follow=True),
    ],
    ids=["text", "simulation"],
)
def test_a_file_that_the_user_names_keeps_its_link_and_permissions(rewrite, tmp_path):
    target, link = tmp_path / "real.csv", tmp_path / "link.csv"
    target.write_text("old", encoding="utf-8")
    target.chmod(0o640)
    link.symlink_to(target.name)
    rewrite(link)
    assert (link.is_symlink(), target.stat().st_mode & 0o777) == (True, 0o640)
    assert target.read_text(encoding="utf-8") != "old"
    target.chmod(0o440)
    with pytest.raises(InputError, match=r"link\.csv: cannot be written: it is write-protected\. Name another file"):
        rewrite(link)


def test_an_old_result_is_replaced(result, tmp_path):
    (tmp_path / "result.json").write_text("old", encoding="utf-8")
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    write(result, Line(), tmp_path)
    assert json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["status"] == "converged"
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("breaks_at", range(len(FILES)))
def test_all_files_stay_unchanged_if_one_cannot_be_replaced(result, tmp_path, monkeypatch, breaks_at):
    for name in FILES[1:]:
        (tmp_path / name).write_text(f"old {name}", encoding="utf-8")
    before = everything_in(tmp_path)
    moved, replace = [], Path.replace

    def fails(self, target):
        if self.parent.name.startswith(".kennfeld"):
            moved.append(target)
            if len(moved) == breaks_at + 1:
                raise PermissionError(13, "opened by a spreadsheet")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(InputError, match="opened by a spreadsheet"):
        write(result, Line(), tmp_path)
    assert everything_in(tmp_path) == before


def test_files_are_replaced_on_a_file_system_without_links(result, tmp_path, monkeypatch):
    def refuses(source, target):
        raise OSError(1, "no links here")

    monkeypatch.setattr(os, "link", refuses)
    for _ in range(2):
        write(result, Line(), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(FILES)


def test_an_interrupt_while_writing_leaves_the_old_files(result, tmp_path, monkeypatch):
    write(result, Line(), tmp_path)
    before = everything_in(tmp_path)

    class Interrupted(Line):
        formats = (".dcm",)
        further_results = ()
        surrogates = ()

    def stops(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("kennfeld.project.results._write_trace", stops)
    with pytest.raises(KeyboardInterrupt):
        write(result, Interrupted(), tmp_path)
    assert everything_in(tmp_path) == before


def test_requiring_space_leaves_no_files(tmp_path):
    require_room(tmp_path / "a" / "b")
    assert not list(tmp_path.iterdir())
    (tmp_path / "results").mkdir()
    require_room(tmp_path / "results")
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_a_file_in_the_place_of_the_folder_is_an_error(tmp_path):
    (tmp_path / "results").write_text("a file", encoding="utf-8")
    with pytest.raises(InputError, match=r"results: cannot be written.*-o"):
        require_room(tmp_path / "results")
    with pytest.raises(InputError, match="cannot be written"):
        require_room(tmp_path / "results" / "deeper")


def test_shifts_of_a_result_are_read(result, tmp_path):
    assert read_shifts(tmp_path) == {}
    write(replace(result, shifts={"drive": {"Torque": -0.25}}), Line(), tmp_path)
    assert read_shifts(tmp_path) == {"drive": {"Torque": -0.25}}


@pytest.mark.parametrize("text", ["{", "[]", '{"shifts": {"drive": 1}}', '{"shifts": {"drive": {"Torque": "late"}}}'])
def test_damaged_shifts_name_their_file(text, tmp_path):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(InputError, match=r"result\.json.*its shifts cannot be read"):
        read_shifts(tmp_path)


def test_changed_labels_are_written_with_their_values_and_no_others(tmp_path):
    class Changing(Line):
        formats = (".dcm", ".cdfx", ".hex")
        further_results = (".changed",)

    start = {"a": 0.0, "b": 2.0}
    half = calibrate("y = a + b * x", {"x": [0.0, 1, 2], "t": [1.0, 3, 5]}, start, target="t", free=["a"])
    written = write(half, Changing(), tmp_path)
    changed = [path.name for path in written if path.name.startswith("changed")]
    assert changed == ["changed.cdfx", "changed.dcm"]
    for name in changed:
        assert {label: p.value for label, p in read_parameters(tmp_path / name).items()} == {"a": pytest.approx(1.0)}
    assert list(read_parameters(tmp_path / "parameters.json")) == ["a", "b"]
