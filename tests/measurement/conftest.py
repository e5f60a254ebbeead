"""Small workbooks without a library that writes them, and the real files beside the repository."""

import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

import pytest

REAL = Path(__file__).parents[3] / "shared" / "data"
MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
RELATED = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGED = 'xmlns="http://schemas.openxmlformats.org/package/2006/relationships"'
TYPES = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"


@pytest.fixture
def real():
    """A real file by its path under the shared folder; skips where that is absent."""

    def find(name):
        path = REAL / name
        if not path.exists():
            pytest.skip(f"the real recordings are not here: {path}")
        return path

    return find


@pytest.fixture
def csv(tmp_path):
    """Writes a text file, bench.csv by default."""

    def write(text, name="bench.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        return path

    return write


@pytest.fixture
def xlsx(tmp_path):
    """Writes a workbook from sheets of rows; a cell is None, a number, a bool or text."""

    def write(name="bench.xlsx", **sheets):
        path = tmp_path / name
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            _write_workbook(archive, sheets)
        return path

    return write


def _write_workbook(archive, sheets):
    listed = enumerate(sheets, 1)
    rows = [(f"sheet{i}", name, f"rId{i}", i) for i, name in listed]
    entries = "".join(f'<sheet name="{name}" sheetId="{i}" r:id="{rid}"/>' for _, name, rid, i in rows)
    links = "".join(
        f'<Relationship Id="{rid}" Type="{RELATED}/worksheet" Target="worksheets/{file}.xml"/>'
        for file, _, rid, _ in rows
    )
    root = f'<Relationship Id="rId1" Type="{RELATED}/officeDocument" Target="xl/workbook.xml"/>'
    archive.writestr(
        "[Content_Types].xml",
        '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
        '<Default Extension="xml" ContentType="application/xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{TYPES}"/></Types>',
    )
    archive.writestr("_rels/.rels", f"<Relationships {PACKAGED}>{root}</Relationships>")
    archive.writestr("xl/workbook.xml", f'<workbook {MAIN} xmlns:r="{RELATED}"><sheets>{entries}</sheets></workbook>')
    archive.writestr("xl/_rels/workbook.xml.rels", f"<Relationships {PACKAGED}>{links}</Relationships>")
    for (file, *_), content in zip(rows, sheets.values(), strict=True):
        data = content if isinstance(content, str) else "".join(_row(i, cells) for i, cells in enumerate(content, 1))
        archive.writestr(f"xl/worksheets/{file}.xml", f"<worksheet {MAIN}><sheetData>{data}</sheetData></worksheet>")


def _row(number, cells):
    return f'<row r="{number}">{"".join(_cell(f"{chr(65 + i)}{number}", cell) for i, cell in enumerate(cells))}</row>'


def _cell(at, cell):
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return f'<c r="{at}" t="b"><v>{int(cell)}</v></c>'
    if isinstance(cell, str):
        return f'<c r="{at}" t="inlineStr"><is><t>{escape(cell)}</t></is></c>'
    return f'<c r="{at}"><v>{cell!r}</v></c>'
