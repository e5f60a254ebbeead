"""A format of another package works as those of Kennfeld do; one that is broken is named and left out."""

import os
import re
import subprocess
import sys
from pathlib import Path

import format_docs
import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.questions.additions import kinds_of
from kennfeld.base.errors import InputWarning
from kennfeld.files import identify
from kennfeld.files.plugins import formats_of_plugins
from kennfeld.terminal.file_info import describe_file
from tests.files.packages import forget_packages, install

PAGE = Path(__file__).parents[2] / "docs" / "adding-a-format.md"
LOG = "ACME1\ntime x/V y/Nm\n0 1 2.1\n0.1 2 3.9\n0.2 3 6\n0.3 4 8.2\n"
PROJECT = """
[model]
file = "gain.kf"

[[dataset]]
files = ["drive.acme"]

[[criterion]]
node = "torque"
target = "y"

[parameters.k]
initial = 1.0
"""


@pytest.fixture
def packages(tmp_path, monkeypatch):
    folder = tmp_path / "packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    forget_packages()
    yield folder
    forget_packages()


@pytest.fixture
def acme(packages):
    """The package of the documentation."""
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    install(packages, "acme_logs", code, "acme = acme_logs:FORMAT")
    return packages


def test_the_package_of_the_documentation_reads_its_logs(acme, tmp_path):
    path = tmp_path / "drive.acme"
    path.write_text(LOG, encoding="utf-8")
    assert identify(path).format.name == "ACME log"
    recording = kf.read(path, ["y"], raster=0.05)
    assert recording["y"].unit == "Nm"
    assert recording["y"].values == pytest.approx([2.1, 3, 3.9, 4.95, 6, 7.1, 8.2])
    assert describe_file(path).summary == "drive.acme: measurement (ACME log), 3 channels over 4 samples"
    assert kinds_of(tmp_path, ["drive.acme"]) == {"drive.acme": "recording"}


def test_the_package_of_the_documentation_is_listed_beside_the_formats_of_kennfeld(acme):
    row = "| ACME log | `.acme` | logs of the ACME recorder, version 1 |"
    listed = format_docs.table("measurements", formats_of_plugins()).split("\n")
    assert [each for each in listed if each not in format_docs.table("measurements")] == [row]


def test_a_project_is_calibrated_on_such_a_log(acme, tmp_path):
    (tmp_path / "drive.acme").write_text(LOG, encoding="utf-8")
    (tmp_path / "gain.kf").write_text("torque[Nm] = k * x\nscalar k\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    command = [sys.executable, "-m", "kennfeld", "calibrate", str(tmp_path / "kennfeld.toml")]
    paths = os.pathsep.join([str(acme), *filter(None, [os.environ.get("PYTHONPATH", "")])])
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=120, env={**os.environ, "PYTHONPATH": paths}
    )
    assert "converged" in done.stdout
    x, y = np.array([1, 2, 3, 4.0]), np.array([2.1, 3.9, 6, 8.2])
    fitted = kf.read_parameters(tmp_path / "results" / "parameters.json")
    assert fitted["k"].value == pytest.approx(x @ y / (x @ x))


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import nothing_of_this_name\n", "ModuleNotFoundError: No module named 'nothing_of_this_name'"),
        ("FORMAT = 3\n", "broken:FORMAT is of the type int, not FileFormat"),
        ("", "has no attribute 'FORMAT'"),
    ],
)
def test_a_broken_format_is_named_and_left_out(packages, tmp_path, code, message):
    install(packages, "broken", code, "lost = broken:FORMAT")
    sys.modules.pop("broken", None)
    path = tmp_path / "drive.csv"
    path.write_text("time,a\n0,1\n1,2\n", encoding="utf-8")
    with pytest.warns(InputWarning, match="the format lost of the package broken cannot be loaded") as caught:
        assert kf.read(path).samples == 2
    assert message in str(caught[0].message)


def test_a_recogniser_that_fails_recognises_nothing(packages, tmp_path):
    code = (
        "from kennfeld.files import FileFormat, MeasurementReader\n"
        "FORMAT = FileFormat('lost', ('.x',), lambda head: 1 / 0, MeasurementReader(dataset=lambda path: None))\n"
    )
    install(packages, "failing", code, "failing = failing:FORMAT")
    path = tmp_path / "drive.csv"
    path.write_text("time,a\n0,1\n1,2\n", encoding="utf-8")
    with pytest.warns(InputWarning, match="the format lost cannot recognise files"):
        assert kf.read(path).samples == 2


def test_a_file_other_than_a_recording_is_refused(packages, tmp_path):
    code = (
        "from kennfeld.files import FileFormat, MeasurementReader\n"
        "reader = MeasurementReader(dataset=lambda path: [])\n"
        "FORMAT = FileFormat('list', ('.l',), lambda head: head.raw[:1] == b'[', reader)\n"
    )
    install(packages, "lists", code, "lists = lists:FORMAT")
    (tmp_path / "a.l").write_text("[1]", encoding="utf-8")
    with pytest.raises(kf.InputError, match="the format list returned a value of the type list, not Dataset"):
        kf.read(tmp_path / "a.l")


@pytest.mark.parametrize("place", ["", "."])
def test_a_package_in_the_present_folder_is_not_loaded(tmp_path, monkeypatch, place):
    """As in a notebook, or with `python -m`: the folder may be the project of a stranger."""
    install(tmp_path, "stranger", "raise SystemExit('code of a stranger')", "stranger = stranger:FORMAT")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [place and str(tmp_path), *sys.path])
    forget_packages()
    try:
        assert formats_of_plugins() == ()
    finally:
        forget_packages()
