"""Workbooks that a program saved without the values of their formulas."""

import zipfile

import pytest

from kennfeld import calfiles
from kennfeld.base.errors import InputError
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve
from kennfeld.measurement import describe, read

CELL = '<c r="{0}"><v>{1}</v></c>'
TEXT = '<c r="{0}" t="inlineStr"><is><t>{1}</t></is></c>'


def sheet(*cells):
    """Rows of two columns below names; the cells of the second column are XML."""
    rows = "".join(
        f'<row r="{k}">{CELL.format(f"A{k}", k)}{cell.format(f"B{k}")}</row>' for k, cell in enumerate(cells, 2)
    )
    return f'<row r="1">{TEXT.format("A1", "Speed")}{TEXT.format("B1", "Torque")}</row>{rows}'


@pytest.mark.parametrize(
    "cell",
    [
        '<c r="{0}"><f>A2*2</f><v></v></c>',
        '<c r="{0}"><f>A2*2</f><v/></c>',
        '<c r="{0}" s="3"><f>A2&lt;2</f></c>',
        '<c r="{0}"><f t="shared" si="0"/><v /></c>',
    ],
)
def test_formulas_without_saved_values_are_named(xlsx, cell):
    path = xlsx(Data=sheet(CELL.replace("{1}", "7"), cell, cell))
    data = read(path)
    assert data["Torque"].values.tolist()[0] == 7
    (remark,) = data.findings
    assert remark.severity == "warning"
    assert str(remark) == (
        "bench.xlsx: sheet Data holds 2 formulas whose values were not saved, in B3 and others; they are read as "
        "missing. Open the workbook in Excel or LibreOffice, which compute them, and save it."
    )
    assert describe(path).tables[0].findings == (remark,)


def test_a_sheet_of_nothing_else_is_refused_with_the_reason(xlsx):
    formula = '<c r="A2"><f>1+1</f><v></v></c>'
    path = xlsx(Data=f'<row r="1">{TEXT.format("A1", "Speed")}</row><row r="2">{formula}</row>')
    with pytest.raises(InputError, match=r"sheet Data holds 1 formula whose value was not saved, in A2\. Open"):
        read(path)


def test_formulas_with_values_and_empty_texts_are_read_without_a_remark(xlsx):
    saved = '<c r="{0}"><f>A2*2</f><v>4</v></c>'
    empty = '<c r="{0}" t="str"><f>""</f><v></v></c>'
    assert read(xlsx(Data=sheet(saved, saved, empty))).findings == ()


def test_a_calibration_workbook_is_named_as_one(tmp_path):
    path, resaved = tmp_path / "start.xlsx", tmp_path / "resaved.xlsx"
    calfiles.write(ParameterSet([Curve("C", Axis([0, 1, 2]), [12.5, 13.5, 14.5])]), path)
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(resaved, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b"<v>13.5</v>", b"<f>12.5+1</f><v></v>"))
    with pytest.raises(InputError) as caught:
        calfiles.read(resaved)
    assert "resaved.xlsx: sheet C holds 1 formula whose value was not saved, in " in str(caught.value)
