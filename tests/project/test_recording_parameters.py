"""`per = "recording"`: a scalar of the function with a value for each file."""

import json

import numpy as np
import pytest

from kennfeld import Project, cli

FORMULA = "input x\nscalar Gain\nscalar Offset\ny = Gain * x + Offset\n"
OFFSETS = (0.3, -0.7, 1.2, 0.5)
PROJECT = """
[model]
file = "line.kf"

[[dataset]]
name = "first days"
files = ["day_1.csv", "day_2.csv"]

[[dataset]]
name = "test"
files = ["day_3.csv"]
use = "test"

[[dataset]]
name = "last day"
files = ["day_4.csv"]

[[criterion]]
node = "y"
target = { channel = "m" }

[parameters.Gain]
initial = 1.0

[parameters.Offset]
per = "recording"
initial = 0.25
"""


@pytest.fixture
def project(tmp_path):
    """Write a project whose recordings differ by an offset; `more` are lines at its end."""

    def write(text=PROJECT, formula=FORMULA, more=""):
        (tmp_path / "line.kf").write_text(formula, encoding="utf-8")
        for number, offset in enumerate(OFFSETS, 1):
            x = np.linspace(0, number, 7)
            rows = np.column_stack([x, 2 * x + offset])
            np.savetxt(tmp_path / f"day_{number}.csv", rows, "%.12g", ",", header="x,m", comments="")
        (tmp_path / "kennfeld.toml").write_text(text + more, encoding="utf-8")
        return tmp_path / "kennfeld.toml"

    return write


def errors(path):
    return [str(finding) for finding in Project.read(path).check() if finding.severity == "error"]


def test_each_recording_has_its_value_and_test_data_keep_the_initial_one(project):
    result = Project.read(project()).calibrate()
    offset = result.parameters["Offset"]
    np.testing.assert_array_equal(offset.axes[0].breakpoints, [1, 2, 3, 4])
    np.testing.assert_allclose(offset.values, [0.3, -0.7, 0.25, 0.5], atol=1e-9)
    assert result.parameters["Gain"].values == pytest.approx(2.0, abs=1e-9)
    assert (result.status, result.free_values) == ("converged", 4)
    assert "kept at their start" not in result.message


def test_the_offset_of_a_reference_can_be_locked(project):
    result = Project.read(project(more="lock = [{ x = [1, 1] }]\n")).calibrate()
    np.testing.assert_allclose(result.parameters["Offset"].values[:3:2], [0.25, 0.25])
    assert result.free_values == 3


def test_values_start_from_the_scalar_of_a_calibration_file_or_from_an_earlier_result(project, tmp_path):
    (tmp_path / "start.dcm").write_text("FESTWERT Offset\n WERT 0.125\nEND\n")
    path = project(PROJECT.replace("initial = 0.25\n", ""), more='[calibration]\ninitial = "start.dcm"\n')
    assert cli.run(["calibrate", str(path), "--quiet"]) == 0
    content = json.loads((tmp_path / "results" / "result.json").read_text(encoding="utf-8"))
    assert content["status"] == "converged"
    path = project(PROJECT.replace("initial = 0.25\n", ""), more='[calibration]\ninitial = "results/parameters.json"\n')
    values = Project.read(path).problem().parameters["Offset"].values
    np.testing.assert_allclose(values, [0.3, -0.7, 0.125, 0.5], atol=1e-9)


def test_conditions_and_calculated_channels_read_the_number(project):
    text = PROJECT.replace('name = "first days"', 'name = "first days"\nwhere = "recording != 2"')
    text += '[calculated]\nlate = "recording * 2"\n'
    [data, *_] = Project.read(project(text)).problem().datasets
    np.testing.assert_array_equal(data["recording"].values[data.scored], np.ones(7))


def test_a_recorded_channel_of_this_name_precedes_the_numbers(project, tmp_path):
    path = project()
    for number in (1, 2, 3, 4):
        file = tmp_path / f"day_{number}.csv"
        header, *rows = file.read_text().splitlines()
        file.write_text("\n".join([f"{header},recording", *(f"{row},{number % 2}" for row in rows)]))
    offset = Project.read(path).problem().parameters["Offset"]
    np.testing.assert_array_equal(offset.axes[0].breakpoints, [0, 1])


@pytest.mark.parametrize(
    ("text", "formula", "message"),
    [
        (PROJECT.replace('per = "rec', 'x = { count = 3 }\nper = "rec'), FORMULA, "x: contradicts per = 'recording'"),
        (PROJECT, FORMULA.replace("scalar Offset\n", "").replace("+ Offset", "+ Offset(x)"), "Offset is a table of"),
        (PROJECT + "[cluster]\npartition = 5\n", FORMULA, "Data in partitions are not numbered"),
        (
            PROJECT.split("[[dataset]]")[0]
            + '[[dataset]]\nfiles = ["day_1.csv"]\n\n[[criterion]]'
            + PROJECT.split("[[criterion]]")[1],
            FORMULA,
            "there is one recording, so that Offset has one value",
        ),
    ],
)
def test_what_cannot_have_a_value_for_each_recording_is_one_message(project, text, formula, message):
    [error] = errors(project(text, formula))
    assert message in error
