"""Projects whose result is rounded to what a control unit stores."""

import json

import numpy as np
import pytest

from kennfeld import Axis, Curve, Scalar
from kennfeld.calfiles import read
from kennfeld.cli import run
from kennfeld.project import Project
from kennfeld.report import document
from kennfeld.report.stored_result import read_result
from tests.project.flash_files import A2L, hex_of

START = 'initial = { a2l = "ecu.a2l", hex = "ecu.hex" }'
BYTES = A2L.replace("UWORD ROW_DIR", "UBYTE ROW_DIR").replace("0x1006", "0x1003").replace("0.01 0", "0.07 0.5")
FORMATS = ["dcm", "csv", "cdfx", "xlsx", "json", "hex"]


@pytest.fixture
def flash(shop):
    """The project with its start in an image of bytes whose steps are coarse, and all formats as output."""
    shop.write("ecu.a2l", BYTES)
    shop.write("ecu.hex", hex_of(10, 10, 10, 0, size=1))
    shop.change('initial = "start.json"', f'{START}\noutput = {json.dumps(FORMATS)}\nrounding = "joint"')
    return shop


def test_every_file_of_the_result_carries_the_same_storable_values(flash, capsys):
    assert flash.errors() == []
    assert run(["calibrate", str(flash.path)]) == 0
    printed = capsys.readouterr()
    assert "Rounded to storage: RMSE  unrounded  nearest" in printed.out
    assert "rounded to storable values" not in printed.err  # nothing was left to be rounded when the image was written
    results = flash.folder / "results"
    stored = read(results / "parameters.json")
    gain, offset = stored["Gain"].values, stored["offset"].values
    numbers = np.rint((gain - 0.5) / 0.07)
    np.testing.assert_array_equal(gain, 0.07 * numbers + 0.5)
    np.testing.assert_array_equal(offset, 0.1 * np.rint(offset / 0.1))
    image = bytes.fromhex((results / "parameters.hex").read_text().splitlines()[0][9:-2])
    assert list(image) == [*numbers, np.rint(offset / 0.1)]
    for ending in FORMATS:
        a2l = (flash.folder / "ecu.a2l",) if ending == "hex" else ()
        written = read(results / f"parameters.{ending}", *a2l)
        np.testing.assert_array_equal(written["Gain"].values, gain, err_msg=ending)
        assert written["offset"].value == float(offset), ending
    content = json.loads((results / "result.json").read_text(encoding="utf-8"))
    assert content["rounding"]["joint"] == {"Predict/bench": content["quality"][0]["rmse_after"]}
    assert content["rounding"]["labels"]["Gain"]["bits"] == 8


def test_a_result_that_is_read_back_has_its_rounding_and_the_report_a_section(flash):
    run(["calibrate", str(flash.path)])
    project = Project.read(flash.path)
    result, _ = read_result(flash.folder / "results", project.problem())
    rounding = result.rounding
    assert rounding.as_json() == project.calibrate().rounding.as_json()
    page = document(project, result)
    assert "What is flashed" in page
    assert "No value is farther than 2 steps from the fit." in page


def test_nearest_needs_no_image_but_an_a2l_file_and_a_step_precedes_it(flash):
    flash.change(START, 'initial = "start.json"\nstorage = "ecu.a2l"').change(json.dumps(FORMATS), '["dcm"]')
    flash.change('rounding = "joint"', 'rounding = "nearest"\nmax_shift = 3').add("[parameters.offset]\nstep = 2\n")
    rounding = flash.project.problem().rounding
    assert (rounding.method, rounding.max_shift) == ("nearest", 3.0)
    assert {name: grid.step for name, grid in rounding.grids.items()} == {"Gain": 0.07, "offset": 2.0}
    assert flash.project.calibrate().parameters["offset"].value in (4.0, 6.0)


def test_what_is_not_rounded_is_a_remark_of_the_check(flash):
    flash.write(
        "ecu.a2l",
        BYTES.replace('LINEAR "%5.1" "Nm" COEFFS_LINEAR 0.1 0', 'FORM "%5.1" "Nm" /begin FORMULA "X1" /end FORMULA'),
    )
    flash.change(START, 'initial = "start.json"\nstorage = "ecu.a2l"').change(json.dumps(FORMATS), '["dcm"]')
    remarks = [str(finding) for finding in flash.project.check() if finding.severity == "remark"]
    assert any(
        "offset is not rounded: it has the conversion TENTH of the kind FORM, which is not linear in ecu.a2l" in r
        for r in remarks
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('rounding = "joint"', 'storage = "ecu.a2l"', "[calibration] storage: storage requires rounding"),
        ('rounding = "joint"', "max_shift = 4", "[calibration] max_shift: max_shift requires rounding"),
        ('rounding = "joint"', 'rounding = "down"', 'rounding: unknown value \'down\'. Write "joint" or "nearest".'),
        ('rounding = "joint"', 'rounding = "joint"\nmax_shift = 0.5', "max_shift: must be >= 1"),
        ('rounding = "joint"', 'rounding = "joint"\nstorage = "eco.a2l"', "eco.a2l: A2L file not found"),
        (START, 'initial = "start.json"', "no step is known to round to"),
        ('rounding = "joint"', "[parameters.offset]\nstep = 2", "step requires rounding"),
        ('rounding = "joint"', 'rounding = "joint"\n[parameters.offset]\nstep = 0', "step: must be > 0"),
        (
            'rounding = "joint"',
            'rounding = "joint"\n[parameters.Gain]\nbounds = [0.51, 0.55]',
            "the bounds such as 0.51 to 0.55 of 3 values of Gain contain no value that can be stored: its step is 0.07",
        ),
    ],
)
def test_errors_of_the_rounding_are_findings(flash, old, new, message):
    flash.change(json.dumps(FORMATS), '["dcm"]')
    assert message in "\n".join(flash.change(old, new).errors())


def test_a_group_axis_of_the_initial_file_gets_a_step_in_its_section(shop):
    speed = Axis([1010, 2000, 3020], name="AxisSpeed")
    shop.values("start.json", Curve("Gain", speed, [1.0, 1.0, 1.0]), Scalar("offset", 0.0))
    shop.change('initial = "start.json"', 'initial = "start.json"\nrounding = "joint"').add(
        "[axes.AxisSpeed]\nstep = 50\n"
    )
    texts = [str(finding) for finding in shop.project.check()]
    assert any("2 breakpoints of AxisSpeed rounded to the step of 50 before the fit" in text for text in texts)
    assert not [text for text in texts if "no table of this file uses the axis" in text]
    points = shop.project.problem().parameters["Gain"].axes[0].breakpoints
    assert points.tolist() == [1000, 2000, 3000]
    shop.change('rounding = "joint"', "")
    assert any("AxisSpeed" in text and "step requires rounding" in text for text in shop.errors())
