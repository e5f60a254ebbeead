"""Messages about a calibration that replaces the initial values, the same from each command that takes one."""

import numpy as np
import pytest

from kennfeld import Curve, ParameterSet, Scalar
from kennfeld.base.errors import Location
from kennfeld.cli import run
from kennfeld.project.replaced_values import replaced_value_findings
from tests.project.conftest import TOML

BOUNDS = "[parameters.Gain]\nbounds = [0, 2.5]\n"
AXIS = [1000, 2000, 3000]


@pytest.fixture
def findings_on(shop):
    """Return the sentences on a calibration, given the bounds of Gain."""
    shop.toml = TOML + BOUNDS
    problem = shop.project.problem()

    def sentences(*parameters):
        findings = replaced_value_findings(problem, ParameterSet(parameters), Location("after.dcm"))
        return [f"{finding.severity}: {finding}" for finding in findings]

    return sentences


def test_a_calibration_that_fits_is_passed_in_silence(findings_on):
    assert findings_on(Curve("Gain", AXIS, [0, 1, 2.5]), Scalar("offset", 1e9)) == []


def test_values_outside_of_the_bounds_of_the_project_are_named(findings_on):
    assert findings_on(Curve("Gain", AXIS, [-0.25, 1, 3]), Scalar("offset", 0.0)) == [
        "warning: after.dcm: 2 of 3 values of Gain are outside the bounds of the project, such as -0.25. "
        "It must be 0 to 2.5; it is used as it is."
    ]
    # on other breakpoints, bounds that are the same everywhere hold as well
    assert "1 of 2 values of Gain" in findings_on(Curve("Gain", [0, 5000], [1, 3]), Scalar("offset", 0.0))[0]


def test_an_unknown_name_is_reported_with_the_one_that_is_meant(findings_on):
    assert findings_on(Curve("Gain", AXIS, [0, 1, 2]), Scalar("Offset", 1.0)) == [
        "remark: after.dcm: initial values are used for offset, which the calibration does not state. "
        "Did you mean Offset?",
        "remark: after.dcm: the function does not use Offset, which the calibration states",
    ]
    assert findings_on(Scalar("K", 1.0)) == [
        "warning: after.dcm: the calibration has no parameter of the function: the initial values are used. "
        "Check the names in the calibration file."
    ]


@pytest.mark.parametrize("command", [["simulate"], ["export", "--to", "m"]])
def test_each_command_that_takes_a_calibration_prints_the_same_messages(command, shop, capsys):
    shop.toml = TOML + BOUNDS
    path = shop.project.path
    values = ParameterSet([Curve("Gain", AXIS, [0, 1, 3]), Scalar("Elsewhere", np.inf)])
    values.save(path.parent / "after.json")
    assert run([*command, str(path), "-p", str(path.parent / "after.json")]) == 0
    err = capsys.readouterr().err
    assert "1 of 3 values of Gain are outside the bounds of the project, such as 3" in err
    assert "initial values are used for offset" in err
    assert "the function does not use Elsewhere" in err
