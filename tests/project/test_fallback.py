"""A result whose folder cannot be written goes to another place."""

import json
import shutil
import tempfile
from pathlib import Path

import pytest

from kennfeld import InputError, calibrate, read_parameters
from kennfeld.base.errors import Findings, Location
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.rbf import Expansion
from kennfeld.project import fallback, folder_replacement
from kennfeld.project.fallback import write_somewhere, write_surrogate_somewhere, write_validation_somewhere
from kennfeld.project.results import require_room
from kennfeld.surrogate import StaticSurrogate
from kennfeld.surrogate.surrogate_file import read_surrogate
from tests.project.simulated_datasets import SimulatedDatasets


class Line:
    """What results need of a project."""

    formats = (".dcm",)
    surrogates = ()
    is_partitioned = False
    further_results = ()

    def change_of_function(self, parameters, ending):
        return parameters

    def simulation(self, parameters=None, shifts=None):
        return SimulatedDatasets(Dataset.of("bench", {"y": [1.0, 2.0]}))


@pytest.fixture(scope="module")
def result():
    return calibrate("y = a + b * x", {"x": [0.0, 1, 2], "t": [1.0, 3, 5]}, {"a": 0.0, "b": 0.0}, target="t")


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A folder of its own for temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def full_below(monkeypatch, *folders):
    """Let the disk be full as soon as files in these folders are written through."""
    sync = folder_replacement._sync

    def fails(path):
        if any(folder in path.parents for folder in folders):
            raise OSError(28, "No space left on device")
        sync(path)

    monkeypatch.setattr(folder_replacement, "_sync", fails)


def test_a_result_goes_to_its_folder_without_a_word(result, tmp_path, temporary):
    told = Findings()
    written = write_somewhere(result, Line(), tmp_path / "results", {}, None, told)
    assert {path.parent for path in written} == {tmp_path / "results"}
    assert len(told) == 0
    assert not list(temporary.iterdir())


def test_where_a_disk_is_full_all_files_go_to_a_temporary_folder(result, tmp_path, temporary, monkeypatch):
    full_below(monkeypatch, tmp_path / "results")
    told = Findings()
    written = write_somewhere(result, Line(), tmp_path / "results", {"report.html": "<p></p>"}, None, told)
    (other,) = temporary.iterdir()
    assert {path.parent for path in written} == {other}
    assert json.loads((other / "result.json").read_text(encoding="utf-8"))["status"] == result.status
    assert [f"{one.severity} {one}" for one in told] == [
        f"error {tmp_path / 'results'}: cannot be written: No space left on device. Written to {other} instead."
    ]
    assert not list((tmp_path / "results").iterdir())


def test_where_that_is_too_small_the_parameters_go_there(result, tmp_path, temporary, monkeypatch):
    full_below(monkeypatch, tmp_path)
    told = Findings()
    (path,) = write_somewhere(result, Line(), tmp_path / "results", {}, None, told)
    assert [one.name for one in temporary.iterdir()] == [path.parent.name]
    assert read_parameters(path)["b"].value == pytest.approx(2.0)


def test_where_nothing_can_be_written_that_is_said(result, tmp_path, monkeypatch):
    (tmp_path / "results").write_text("a file", encoding="utf-8")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "results"))
    told = Findings()
    assert write_somewhere(result, Line(), tmp_path / "results", {}, None, told) == ()
    assert "A temporary folder cannot be written either." in str(next(iter(told)))


def test_a_fault_in_a_writer_loses_no_values(result, tmp_path, temporary, monkeypatch):
    def fails(*_):
        raise ZeroDivisionError("so")

    monkeypatch.setattr(fallback, "write", fails)
    told = Findings()
    (path,) = write_somewhere(result, Line(), tmp_path / "results", {}, None, told)
    assert read_parameters(path)["b"].value == pytest.approx(2.0)
    assert "cannot be written (ZeroDivisionError: so). Written to" in str(next(iter(told)))


def test_an_interrupt_is_no_failure_to_write(result, tmp_path, temporary, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(fallback, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_somewhere(result, Line(), tmp_path / "results", {}, None, Findings())
    assert not list(Path(temporary).iterdir())


def test_what_cannot_be_simulated_is_kept_too(result, tmp_path, temporary):
    class Broken(Line):
        def simulation(self, parameters=None, shifts=None):
            raise InputError.of(Location("model"), "cannot be simulated")

    told = Findings()
    (path,) = write_somewhere(result, Broken(), tmp_path / "results", {}, None, told)
    assert path.name == "parameters.json"
    assert "model: cannot be simulated. Written to" in str(next(iter(told)))


def test_a_cross_validation_is_written_elsewhere_if_its_folder_is_gone(tmp_path):
    (tmp_path / "results").write_text("a file", encoding="utf-8")
    findings = Findings()
    [path] = write_validation_somewhere({"folds": []}, tmp_path / "results", findings)
    assert json.loads(path.read_text(encoding="utf-8")) == {"folds": []}
    [finding] = findings
    assert finding.remedy == f"Written to {path.parent} instead."
    shutil.rmtree(path.parent)


def test_a_surrogate_is_written_elsewhere_if_its_folder_is_gone(tmp_path):
    bell = Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]])
    surrogate = StaticSurrogate("bell", ("x",), "y", (), bell)
    findings = Findings()
    path = write_surrogate_somewhere(surrogate, tmp_path / "gone" / "engine.json", findings)
    assert read_surrogate(path).name == "bell"
    assert "cannot be written" in str(*findings)
    shutil.rmtree(path.parent)
    assert write_surrogate_somewhere(surrogate, tmp_path / "engine.json", Findings()) == tmp_path / "engine.json"


def test_a_results_folder_that_vanishes_during_the_run_costs_nothing(tmp_path, monkeypatch):
    result = calibrate("y = a * x", {"x": [0.0, 1, 2], "t": [0.0, 1, 2]}, {"a": 0.0}, target="t")
    (tmp_path / "results").mkdir()
    require_room(tmp_path / "results")
    (tmp_path / "results").rmdir()
    (tmp_path / "results").write_text("a file", encoding="utf-8")
    findings = Findings()
    written = write_somewhere(result, Line(), tmp_path / "results", {}, None, findings)
    assert "result.json" in {path.name for path in written}
    assert findings.has_errors
    shutil.rmtree(written[0].parent)
