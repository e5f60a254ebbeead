"""The rectangle that the cells of a sheet ask for, however the file writes their places."""

import pytest

from kennfeld.base.workbooks.sheet_extent import OVERLAP, extent_of_text


@pytest.mark.parametrize(
    ("text", "extent"),
    [
        ('<row r="1"><c r="A1"><v>1</v></c><c r="B1"/></row>', (26, 1)),
        ('<row r="1"><c r="A1"/></row><row r="9"><c r="C9"/></row>', (26, 9)),
        ('<row r="1"><c r="CV1"/></row><row r="400"><c r="CV400"/></row>', (100, 400)),
        ('<row r="1"><c s="1" r="C5"/></row>', (3, 5)),
        ("<row r='1'><c r = 'xfd1048576'/></row>", (16384, 1048576)),
        ("<row><c/><c/></row><row><c/></row>", (4, 3)),
        ('<row r="1"><c r="A99999999999999999999"/></row>', (26, 999_999_999)),
        ("", (26, 1)),
    ],
)
def test_the_rectangle_holds_all_cells(text, extent):
    raw = text.encode()
    assert extent_of_text(lambda: iter([raw])) == extent


def test_a_place_cut_by_the_end_of_a_part_is_detected():
    raw = b'<row r="1"><c r="A1"/>' + b" " * 200 + b'<c s="0" r="B77"/></row>'
    for cut in range(200, len(raw)):
        assert extent_of_text(lambda: iter([raw[:cut], raw[cut - OVERLAP :]]))[1] >= 77  # noqa: B023


def test_parts_that_end_within_a_cell_are_read_the_fast_way(monkeypatch):
    raw = b"".join(b'<row r="%d"><c r="A%d"/><c r="B%d"/></row>' % (i, i, i) for i in range(1, 30))
    monkeypatch.setattr("kennfeld.base.workbooks.sheet_extent._extent_of_any", lambda chunks: None)
    for cut in range(OVERLAP, len(raw)):
        assert extent_of_text(lambda: iter([raw[:cut], raw[cut - OVERLAP :]])) == (26, 29)  # noqa: B023
