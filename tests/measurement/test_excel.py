"""Workbooks: sheets, titles, units, blank rows and columns, dates, and files that are something else."""

import contextlib
import random

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import read

TABLE = [["Speed", "Torque"], ["rpm", "Nm"], [1000.0, 80.5], [2000.0, 95.25]]


def test_a_plain_sheet_is_read(xlsx):
    data = read(xlsx(Data=TABLE))
    assert data.name == "bench"
    assert data["Torque"].unit == "Nm"
    assert data["Torque"].values.tolist() == [80.5, 95.25]


def test_titles_blank_rows_and_blank_columns_are_passed_over(xlsx):
    rows = [["A bench test"], [], [None, "Speed [rpm]", None, "Gear", "on"], [], [None, 1.5, None, 1, True], []]
    data = read(xlsx(Data=[*rows, [None, 2.5, None, None, False]]))
    assert data["Speed"].unit == "rpm"
    np.testing.assert_array_equal(data["Gear"].values, [1, np.nan])
    assert data["on"].values.tolist() == [1, 0]


def test_the_only_sheet_with_numbers_is_taken(xlsx):
    assert read(xlsx(About=[["by Ada"]], Data=TABLE)).samples == 2


def test_several_tables_ask_for_a_choice(xlsx):
    path = xlsx(First=TABLE, Second=TABLE)
    with pytest.raises(InputError) as caught:
        read(path)
    assert [finding.remedy for finding in caught.value.findings] == [
        "Write bench.xlsx#First to select it.",
        "Write bench.xlsx#Second to select it.",
    ]
    assert read(f"{path}#Second").samples == read(path, sheet="First").samples == 2


def test_a_sheet_that_is_missing_names_the_nearest(xlsx):
    with pytest.raises(InputError, match=r"has no sheet Frist. Did you mean First\?"):
        read(xlsx(First=TABLE), sheet="Frist")


def test_text_among_numbers_is_placed_by_row_and_column(xlsx):
    with pytest.raises(InputError) as caught:
        read(xlsx(Data=[*TABLE, [3000.0, "abc"]]))
    assert str(caught.value).startswith("bench.xlsx sheet Data row 5, column B (Torque): must be a number, got 'abc'")


def test_a_sheet_without_numbers_is_a_finding(xlsx):
    with pytest.raises(InputError, match="sheet Data holds no row of names with numbers below"):
        read(xlsx(Data=[["only", "text"]]))


def test_one_stray_cell_far_away_does_not_fill_the_memory(xlsx):
    cells = '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"><v>1</v></c></row>'
    with pytest.raises(InputError, match="spans up to 1048576 rows and 16384 columns"):
        read(xlsx(Data=cells))


@pytest.mark.parametrize(
    ("far", "span"), [("B1000000000", "100000000 rows and 3"), ("CZ900000", "900000 rows and 104")]
)
def test_a_stray_cell_out_of_its_order_does_not_fill_the_memory(xlsx, far, span):
    cells = f'<row r="1"><c r="A1"><v>1</v></c></row><row r="2"><c s="0" r="{far}"/><c r="C2"><v>1</v></c></row>'
    with pytest.raises(InputError, match=f"spans up to {span} columns"):
        read(xlsx(Data=cells))


def test_a_workbook_that_unpacks_to_too_much_is_refused(xlsx, monkeypatch):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 60)
    blanks = " " * 10_100_000
    with pytest.raises(InputError, match=r"sheet1.xml holds 10 MB or more, packed into 0.0 MB. Such a file"):
        read(xlsx(Data=f'<row r="1"><c r="A1"><v>1</v></c></row>{blanks}'))


def test_a_damaged_workbook_gives_findings_and_nothing_else(xlsx):
    path = xlsx(Data=[*TABLE, *([float(i), i * 0.5] for i in range(100))])
    content, generator = path.read_bytes(), random.Random(5)
    for _ in range(300):
        mutant = bytearray(content)
        for _ in range(generator.randint(1, 5)):
            mutant[generator.randrange(len(mutant))] = generator.randrange(256)
        path.write_bytes(mutant[: generator.randrange(len(mutant))] if generator.random() < 0.3 else mutant)
        with contextlib.suppress(InputError):
            read(path)


def test_the_real_steady_points_are_read(real):
    path = real("engine_steady/engine1_normalized.xlsx")
    data = read(path, sheet="data")
    assert data.samples == 795
    assert len(data) == 11
    assert data["engine_speed"].values[0] == -1.562204200331513
    assert data["NOx"].values[-1] == -1.946135201630112
    with pytest.raises(InputError, match="several sheets hold tables"):
        read(path)


def test_limits_without_end_in_a_real_workbook_are_missing_values(real):
    data = read(f"{real('engine_steady/safety_constraint.xlsx')}#engine1_normalized")
    assert all(np.isfinite(c.values).all() or np.isnan(c.values).any() for c in data.values())
    assert any("row 3, column B (engine_speed" in str(remark) for remark in data.findings)
