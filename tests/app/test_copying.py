"""Pictures and tables are copied and saved from any screen."""

import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np

import kennfeld as kf
from tests.app.browser import READY
from tests.app.shared_app import project_page

SVG = "{http://www.w3.org/2000/svg}"


def saved(page: Any, element: str, way: str) -> Path:
    """Save what an element shows by the menu that appears at it; return the file."""
    page.hover(element)
    page.click(".copy-menu button")
    with page.expect_download() as download:
        page.click(f".copy-menu [data-way={way}]")
    path = Path(str(download.value.path()))
    return path.rename(path.with_name(download.value.suggested_filename))


def test_a_picture_is_saved_as_svg_with_its_texts_and_lines(torque: Path) -> None:
    with project_page(torque, "plots") as page:
        path = saved(page, ".strips .canvas", "svg")
    assert path.name == "torque-Strips-of-bench.svg"
    picture = ElementTree.parse(path).getroot()
    texts = {"".join(text.itertext()).strip() for text in picture.iter(f"{SVG}text")}
    assert {"Strips of bench", "TorquePredict", "Speed", "point", "2000"} <= texts
    assert len(list(picture.iter(f"{SVG}path"))) > 20
    # two lines, calculated and measured, over the width of the strips
    longest = max((path.get("d", "") for path in picture.iter(f"{SVG}path")), key=len)
    assert len(longest) > 2000


def test_a_picture_is_saved_as_png_at_twice_its_size(torque: Path) -> None:
    with project_page(torque, "parameters") as page:
        box = page.locator(".surf .canvas").bounding_box()
        content = saved(page, ".surf canvas", "png").read_bytes()
    assert content.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", content[16:24])
    assert (width, height) == (2 * np.ceil(box["width"]), 2 * (np.ceil(box["height"]) + 24))


def test_a_map_is_copied_with_its_axes_and_all_digits(torque: Path) -> None:
    table = kf.Project.read(torque).problem().parameters["MapOptTorque"]
    with project_page(torque, "parameters") as page:
        page.click("[data-parameter=MapOptTorque]")
        page.wait_for_selector(READY)
        rows = saved(page, "table.grid th.corner", "tsv").read_text(encoding="utf-8").splitlines()
    cells = [row.split("\t") for row in rows]
    assert [float(cell) for cell in cells[0][1:]] == table.axes[0].breakpoints.tolist()
    assert [float(row[0]) for row in cells[1:]] == table.axes[1].breakpoints.tolist()
    np.testing.assert_array_equal([[float(cell) for cell in row[1:]] for row in cells[1:]], table.values.T)


def test_a_list_is_copied_as_a_spreadsheet_reads_it(torque: Path) -> None:
    with project_page(torque, "optimization") as page:
        rows = saved(page, ".cfg table.list td b", "tsv").read_text(encoding="utf-8").splitlines()
    assert rows[0].split("\t")[1:] == ["parameter", "values", "unit", "without data"]
    assert rows[1].split("\t")[1:] == ["MapOptTorque", "247", "Nm", ""]


TYPED_FAST = """async (text) => {
  const pressed = { bubbles: true, cancelable: true };
  const key = (key, more) =>
    document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, ...pressed, ...more }));
  key("k", { ctrlKey: true });
  for (let turn = 0; turn < 5; turn++) await null;
  const input = document.activeElement;
  input.value = text;
  input.dispatchEvent(new Event("input", { bubbles: true }));
  key("Enter");
}"""  # all of it before the page is drawn again


def test_the_palette_saves_pictures_by_name(torque: Path) -> None:
    with project_page(torque, "parameters") as page, page.expect_download() as download:
        page.evaluate(TYPED_FAST, "save svg")
    assert download.value.suggested_filename.endswith(".svg")
