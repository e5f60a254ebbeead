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
    """The part of a project that results need."""

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


def test_a_result_is_written_to_its_folder_without_a_message(result, tmp_path, temporary):
    findings = Findings()
    written = write_somewhere(result, Line(), tmp_path / "results", {}, None, findings)
    assert {path.parent for path in written} == {tmp_path / "results"}
    assert len(findings) == 0
    assert not list(temporary.iterdir())


def test_all_files_are_written_to_a_temporary_folder_if_the_disk_is_full(result, tmp_path, temporary, monkeypatch):
    full_below(monkeypatch, tmp_path / "results")
    findings = Findings()
    written = write_somewhere(result, Line(), tmp_path / "results", {"report.html": "<p></p>"}, None, findings)
    (other,) = temporary.iterdir()
    assert {path.parent for path in written} == {other}
    assert json.loads((other / "result.json").read_text(encoding="utf-8"))["status"] == result.status
    assert [f"{finding.severity} {finding}" for finding in findings] == [
        f"error {tmp_path / 'results'}: cannot be written: No space left on device. Written to {other} instead."
    ]
    assert not list((tmp_path / "results").iterdir())


def test_only_parameters_are_written_to_a_small_temporary_folder(result, tmp_path, temporary, monkeypatch):
    full_below(monkeypatch, tmp_path)
    findings = Findings()
    (path,) = write_somewhere(result, Line(), tmp_path / "results", {}, None, findings)
    assert [folder.name for folder in temporary.iterdir()] == [path.parent.name]
    assert read_parameters(path)["b"].value == pytest.approx(2.0)


def test_a_message_says_that_no_folder_can_be_written(result, tmp_path, monkeypatch):
    (tmp_path / "results").write_text("a file", encoding="utf-8")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "results"))
    findings = Findings()
    assert write_somewhere(result, Line(), tmp_path / "results", {}, None, findings) == ()
    assert "A temporary folder cannot be written either." in str(next(iter(findings)))


def test_a_fault_in_a_writer_does_not_lose_values(result, tmp_path, temporary, monkeypatch):
    def fails(*_):
        raise ZeroDivisionError("so")

    monkeypatch.setattr(fallback, "write", fails)
    findings = Findings()
    (path,) = write_somewhere(result, Line(), tmp_path / "results", {}, None, findings)
    assert read_parameters(path)["b"].value == pytest.approx(2.0)
    assert "cannot be written (ZeroDivisionError: so). Written to" in str(next(iter(findings)))


def test_an_interrupt_does_not_count_as_a_failure_to_write(result, tmp_path, temporary, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(fallback, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_somewhere(result, Line(), tmp_path / "results", {}, None, Findings())
    assert not list(Path(temporary).iterdir())


def test_parameters_that_cannot_be_simulated_are_written(result, tmp_path, temporary):
    class Broken(Line):
        def simulation(self, parameters=None, shifts=None):
            raise InputError.of(Location("model"), "cannot be simulated")

    findings = Findings()
    (path,) = write_somewhere(result, Broken(), tmp_path / "results", {}, None, findings)
    assert path.name == "parameters.json"
    assert "model: cannot be simulated. Written to" in str(next(iter(findings)))


def test_a_cross_validation_is_written_elsewhere_if_its_folder_is_removed(tmp_path):
    (tmp_path / "results").write_text("a file", encoding="utf-8")
    findings = Findings()
    [path] = write_validation_somewhere({"folds": []}, tmp_path / "results", findings)
    assert json.loads(path.read_text(encoding="utf-8")) == {"folds": []}
    [finding] = findings
    assert finding.remedy == f"Written to {path.parent} instead."
    shutil.rmtree(path.parent)


def test_a_surrogate_is_written_elsewhere_if_its_folder_is_removed(tmp_path):
    bell = Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]])
    surrogate = StaticSurrogate("bell", ("x",), "y", (), bell)
    findings = Findings()
    path = write_surrogate_somewhere(surrogate, tmp_path / "gone" / "engine.json", findings)
    assert read_surrogate(path).name == "bell"
    assert "cannot be written" in str(*findings)
    shutil.rmtree(path.parent)
    assert write_surrogate_somewhere(surrogate, tmp_path / "engine.json", Findings()) == tmp_path / "engine.json"


def test_a_result_is_written_elsewhere_if_its_folder_vanishes_during_the_run(tmp_path, monkeypatch):
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
