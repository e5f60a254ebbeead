"""Axes that fall in the initial file fall in all files that a project writes."""

import json
from itertools import product

import numpy as np
import pytest

from kennfeld import ParameterSet, cli, read_parameters
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Map
from kennfeld.optimize.search.problem_digest import problem_digest
from kennfeld.project import Project
from tests.calfiles.stored_tables import STORED_IN

TOML = """\
model.file = "f.kf"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "y"
target = "m"
[calibration]
initial = "start{ending}"
output = [".dcm", ".csv", ".cdfx", ".m", ".xlsx"]
"""
SETTINGS = {
    "nothing": "",
    "bounds": "[parameters.T]\nbounds = [-9, 9]\n[parameters.M]\nbounds = [-9, 9]\n",
    "breakpoints": "[parameters.T]\nx.breakpoints = [0, 4, 10]\n[axes.G]\nbreakpoints = [0, 8, 16, 20]\n"
    '[parameters.M]\nx.axis = "G"\n',
    "free": '[parameters.T]\nx.breakpoints = "free"\n[axes.G]\nbreakpoints = "free"\n[parameters.M]\nx.axis = "G"\n',
    "quantiles": '[parameters.T]\nx = { input = "z", count = 3 }\n',
}


@pytest.fixture
def project(tmp_path):
    """Write a project with a curve and a map over a group axis, both falling."""

    def write(ending, settings="", turned=True):
        speed, z = Axis([0, 10, 20], "x", "rpm", "G", falling=turned), Axis([0, 5, 10], "z", falling=turned)
        start = [Curve("T", z, [1.0, 2.0, 4.0]), Map("M", speed, Axis([0, 9], "z"), [[1, 2], [3, 4], [5, 7]])]
        ParameterSet(start).save(tmp_path / f"start{ending}")
        (tmp_path / "f.kf").write_text("input x[rpm]\ninput z\ny = T(z) + M(x, z)\n", encoding="utf-8")
        x, z = np.meshgrid(np.linspace(0, 20, 9), np.linspace(0, 10, 9))
        columns = np.column_stack([x.ravel(), z.ravel(), (np.sin(x / 5) + np.cos(z / 4)).ravel()])
        np.savetxt(tmp_path / "d.csv", columns, delimiter=",", header="x,z,m", comments="")
        (tmp_path / "p.toml").write_text(TOML.format(ending=ending) + settings, encoding="utf-8")
        return tmp_path / "p.toml"

    return write


def assert_falling(folder, values):
    """Check by other parsers that the files of a folder hold these values, the x axes from the greatest point on."""
    for file in folder.glob("parameters.*"):
        stored = STORED_IN[file.suffix](file)
        for name, table in values.items():
            x, *others = (axis.breakpoints.tolist() for axis in table.axes)
            axes, numbers = stored[name]
            assert [list(points) for points in axes] == [x[::-1], *others]
            assert numbers == dict(zip(product(x, *others), table.values.ravel().tolist(), strict=True))


def test_a_fit_keeps_the_order_of_the_initial_axes(project, tmp_path):
    read = Project.read(project(".csv", SETTINGS["breakpoints"]))
    values = read.calibrate().parameters
    for ending in (".dcm", ".csv", ".cdfx", ".json"):
        values.save(tmp_path / f"parameters{ending}")
    assert_falling(tmp_path, values)


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".dcm", ".csv", ".cdfx", ".m", ".mat", ".xlsx", ".json"])
@pytest.mark.parametrize("settings", SETTINGS)
def test_a_run_writes_the_axes_as_its_initial_file_has_them(project, ending, settings):
    path = project(ending, SETTINGS[settings])
    folder = path.parent / "results"
    assert cli.run(["calibrate", str(path), "-o", str(folder)]) == 0
    values = read_parameters(folder / "parameters.json")
    assert values["T"].values.tolist() != [1.0, 2.0, 4.0]
    assert_falling(folder, values)


def test_the_fit_does_not_depend_on_the_order_of_axes(project):
    digests = []
    for turned in (False, True):
        read = Project.read(project(".csv", SETTINGS["free"], turned))
        digests.append(problem_digest(read.problem(), read.options))
    assert digests[0] == digests[1]


def test_values_of_a_file_are_simulated_in_any_order(project):
    read = Project.read(project(".csv"))
    values = read.problem().parameters
    [expected] = read.simulate(values)
    for ending in (".dcm", ".cdfx", ".json"):
        values.save(read.path.with_name(f"values{ending}"))
        [simulated] = read.simulate(read.read_values(read.path.with_name(f"values{ending}")))
        np.testing.assert_array_equal(simulated["y"].values, expected["y"].values)


def test_files_are_described_converted_and_compared(project, capsys):
    folder = project(".csv").parent
    first, second = folder / "start.csv", folder / "second.cdfx"
    assert cli.run(["convert", str(first), str(second)]) == 0
    assert cli.run(["diff", str(first), str(second)]) == 0
    capsys.readouterr()
    assert cli.run(["info", str(second)]) == 0
    assert "falling" in capsys.readouterr().out
    assert cli.run(["info", str(second), "--json"]) == 0
    [axis] = json.loads(capsys.readouterr().out)["axes"]
    assert (axis["breakpoints"], axis["falling"]) == ([0.0, 10.0, 20.0], True)
