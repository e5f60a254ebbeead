"""Paths of Windows, where the code splits paths itself: with backslashes, drives and colons."""

import os
from pathlib import PureWindowsPath

import pytest

from kennfeld.app.folders import plain_name
from kennfeld.base.errors import Findings
from kennfeld.domain import file_spans
from kennfeld.models import function_files, importer_registry
from kennfeld.preprocessing import recording_sources, recordings


@pytest.fixture(autouse=True)
def windows(monkeypatch):
    """Paths are split as on Windows."""
    monkeypatch.setattr(file_spans, "PurePath", PureWindowsPath)
    monkeypatch.setattr(function_files, "Path", PureWindowsPath)
    monkeypatch.setattr(importer_registry, "Path", PureWindowsPath)
    monkeypatch.setattr(recording_sources, "PurePath", PureWindowsPath)
    monkeypatch.setattr(recordings, "Path", PureWindowsPath)


@pytest.mark.parametrize(
    ("reference", "parts"),
    [
        (r"C:\nets\knock.onnx", (r"C:\nets\knock.onnx", "")),
        (r"C:\models.v2\engine.py:torque", (r"C:\models.v2\engine.py", "torque")),
        (r"..\plant.fmu:simulation", (r"..\plant.fmu", "simulation")),
        (r"C:\models.v2\plant", (r"C:\models.v2\plant", "")),
        ("C:plant", ("C:plant", "")),
        (r"\\server\share\engine.c:eta", (r"\\server\share\engine.c", "eta")),
    ],
)
def test_the_colon_of_a_drive_does_not_separate_a_function(reference, parts):
    assert function_files.split_reference(reference) == parts


@pytest.mark.guests
def test_the_kind_of_a_function_file_does_not_depend_on_its_drive():
    assert function_files.importer_of_function(r"D:\a\KNOCK.ONNX").endings == (".onnx",)
    assert function_files.importer_of_function(r"D:\a.onnx\engine") is None


def test_files_are_told_apart_by_the_ends_of_their_paths():
    names = [r"D:\runs\mon\a.csv", r"D:\runs\tue\a.csv", r"D:\runs\b.csv"]
    assert list(file_spans.short_names(names).values()) == ["mon/a.csv", "tue/a.csv", "b.csv"]


@pytest.mark.parametrize(
    ("address", "name"),
    [
        (r"D:\runs\drive.mf4", "drive.mf4"),
        ("D:/runs/points.xlsx#Sheet 2", "points.xlsx#Sheet 2"),
        ("s3://fleet/runs/drive.mf4", "drive.mf4"),
    ],
)
def test_messages_name_a_recording_without_its_folder(address, name):
    assert recording_sources.RecordingSource(address, "").name == name


def test_a_dataset_is_named_after_its_file():
    assert recordings.default_name([r"D:\runs.2\drive.csv.gz"], r"runs.2\drive.csv.gz") == "drive"
    assert recordings.default_name([r"D:\a\run_1.csv", r"D:\a\run_2.csv"], r"a\run_*.csv") == "run"


@pytest.mark.guests
@pytest.mark.parametrize("name", [r"..\secret.h", r"D:\secret.h", "D:secret.h", "../secret.h"])
def test_c_code_includes_files_of_its_own_folder_only(name, tmp_path):
    from kennfeld.importers.c.preprocessing import preprocess

    folder = tmp_path / "code"
    folder.mkdir()
    literal = [folder / name] if os.name == "posix" else []  # a name as Windows would resolve it
    for path in (*literal, folder / "secret.h", folder / "own.h"):
        path.write_text(f"double {path.stem[-6:]} = 1.0;\n", encoding="utf-8")
    source = preprocess(f'#include "{name}"\n#include "own.h"\n', folder / "engine.c", Findings())
    assert source.missing == (name,)
    assert [line.text for line in source.lines if line.text] == ["double own = 1.0;"]


@pytest.mark.parametrize("name", [r"..\..\a.csv", r"C:\a.csv", "../a.csv", r"C:a.csv"])
def test_an_uploaded_file_stays_in_the_folder(name):
    assert PureWindowsPath(plain_name(name)).name == plain_name(name)
    assert plain_name(name).endswith("a.csv")
