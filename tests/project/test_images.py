"""Projects whose start is an image: the fit goes back into it."""

import pytest

from kennfeld.calfiles import read
from kennfeld.cli import run
from tests.project.flash_files import A2L, hex_of, memory_of

START = 'initial = { a2l = "ecu.a2l", hex = "ecu.hex" }'


@pytest.fixture
def flash(shop):
    """The project with its start in an image, and images as output."""
    shop.write("ecu.a2l", A2L)
    shop.write("ecu.hex", hex_of(100, 100, 100, 0))
    return shop.change('initial = "start.json"', f'{START}\noutput = ["hex", "dcm"]')


def test_the_fitted_values_are_written_into_the_image(flash, capsys):
    assert flash.errors() == []
    assert run(["calibrate", str(flash.path)]) == 0
    written = flash.folder / "results" / "parameters.hex"
    assert memory_of(written.read_bytes()) == [100, 200, 300, 50]
    assert "checksums of the control unit are not updated" in capsys.readouterr().err
    parameters = read(written, flash.folder / "ecu.a2l")
    assert parameters["Gain"].values.tolist() == pytest.approx([1, 2, 3])
    assert read(flash.folder / "results" / "parameters.dcm")["offset"].value == pytest.approx(5, abs=1e-6)


def test_an_image_of_another_program_is_a_warning(flash):
    identity = '/begin MOD_PAR "" EPK "XY" ADDR_EPK 0x1000 /end MOD_PAR'
    flash.write("ecu.a2l", A2L.replace("/begin RECORD_LAYOUT", f"{identity} /begin RECORD_LAYOUT", 1))
    assert "ecu.a2l is for 'XY'. Use the A2L file of this program." in "\n".join(flash.warnings())


def test_an_image_in_a_list_needs_no_description(flash):
    flash.change(START, 'initial = ["start.json", { hex = "ecu.hex" }]')
    assert flash.project.problem().parameters["Gain"].values.tolist() == [1, 1, 1]
    flash.change('{ hex = "ecu.hex" }', '"ecu.hex"')
    assert flash.project.problem().parameters["Gain"].unit == "Nm"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('a2l = "ecu.a2l"', 'a2l = "eco.a2l"', "file eco.a2l does not exist. Did you mean ecu.a2l?"),
        ('hex = "ecu.hex"', 'hex = "no.hex"', "file no.hex does not exist"),
        ('hex = "ecu.hex"', 'hexx = "ecu.hex"', "hexx: unknown key. Did you mean hex?"),
        (START, "initial = [3]", "must be a file, got 3"),
        (START, 'initial = "start.json"', "writing an image requires an existing image to modify"),
        ('output = ["hex"', 'output = ["s19"', "ecu.hex is Intel HEX, which has other endings than .s19"),
    ],
)
def test_errors_of_an_image_are_findings(flash, old, new, message):
    assert message in "\n".join(flash.change(old, new).errors())


def test_an_image_that_cannot_store_the_values_does_not_affect_the_other_results(flash, capsys):
    flash.write("ecu.a2l", A2L.replace("UWORD ROW_DIR", "UBYTE ROW_DIR").replace("0x1006", "0x1003"))
    flash.write("ecu.hex", hex_of(100, 100, 100, 0, size=1))
    flash.write("results/parameters.hex", "of another run")
    assert run(["calibrate", str(flash.path)]) == 2
    message = "parameters.hex Gain: the value [3] is 3 Nm, outside the storable and allowed range"
    assert message in capsys.readouterr().err
    assert not (flash.folder / "results" / "parameters.hex").exists()
    assert read(flash.folder / "results" / "parameters.dcm")["Gain"].values.tolist() == pytest.approx([1, 2, 3])
