"""The screen of the data: files, their channels, and what the function reads."""

from pathlib import Path

import pytest

from tests.app.browser import READY
from tests.app.shared_app import project_page
from tests.app.test_data_overview import SETTINGS, write_drive
from tests.measurement.bus_files import drive, write_mf4

PROJECT = """
[model]
file = "model.kf"

[[dataset]]
files = ["drive_*.csv"]

[parameters.a]
initial = 1.0

[[criterion]]
node = "y"
target = { channel = "m" }
"""


def write_project(folder: Path, *datasets: str) -> Path:
    for number, x in enumerate((1, 9, 5)):
        (folder / f"drive_{number}.csv").write_text(f"x,m\n{x},{2 * x}\n4,8\n", encoding="utf-8")
    (folder / "model.kf").write_text("y = a * x\n", encoding="utf-8")
    (folder / "kennfeld.toml").write_text("".join([PROJECT, *datasets]), encoding="utf-8")
    return folder / "kennfeld.toml"


@pytest.mark.slow
def test_the_range_of_an_input_is_that_over_all_files(tmp_path: Path) -> None:
    with project_page(write_project(tmp_path)) as page:
        page.click("[data-screen=data]")
        page.wait_for_selector("[data-channel=x] td:has-text('1.000')")
        page.wait_for_selector("[data-channel=x] td:has-text('9.000')")


def test_the_error_of_a_log_without_a_database_fits_the_page(tmp_path: Path) -> None:
    write_mf4(tmp_path / "drive.mf4", drive())
    project = write_project(tmp_path, '[[dataset]]\nfiles = ["drive.mf4"]\n')
    with project_page(project) as page:
        page.click("[data-screen=data]")
        box = page.wait_for_selector("td.fault:has-text('in the app, drop it on the page')").bounding_box()
        assert box["x"] + box["width"] <= 1280
        box = page.wait_for_selector("button[aria-label='Remove drive.mf4']").bounding_box()
        assert box["x"] + box["width"] <= 1280


def test_a_shift_is_estimated_kept_and_taken_back_and_a_file_is_turned_off(tmp_path: Path) -> None:
    for number, name in enumerate("abc", 1):
        write_drive(tmp_path / f"{name}.csv", number, late=3)
    (tmp_path / "gain.kf").write_text("y = k * u\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(SETTINGS, encoding="utf-8")
    with project_page(tmp_path / "kennfeld.toml", "data") as page:
        page.click("[aria-label='Estimate the shift of m']")
        said = page.wait_for_selector("section[aria-label='Shift of m'] .foot b").inner_text()
        assert float(said.removesuffix(" s")) == pytest.approx(0.3, abs=0.02)
        assert "late" in page.inner_text("section[aria-label='Shift of m']")
        page.click("button:has-text('Keep')")
        page.wait_for_function(
            "() => document.querySelector('input[aria-label=\"Shift of m\"]').value.startsWith('-0.')"
        )
        page.wait_for_selector(READY)
        page.click("#undo")
        page.wait_for_function("() => document.querySelector('input[aria-label=\"Shift of m\"]').value === ''")
        page.wait_for_selector("[data-file='c.csv'] td b:text-matches('[0-9]')")
        page.locator("[data-file='c.csv']").press("o")
        page.wait_for_selector("[data-file='c.csv'].off")
        page.wait_for_selector(READY)
        assert page.locator(".data .heads > span").all_inner_texts() == ["a.csv", "b.csv"]
        page.click("[data-channel=extra]")
        page.wait_for_selector(".allfiles h2:text-is('extra')")


def test_a_drag_along_the_line_of_a_channel_shifts_it(tmp_path: Path) -> None:
    for number, name in enumerate("abc", 1):
        write_drive(tmp_path / f"{name}.csv", number, late=3)
    (tmp_path / "gain.kf").write_text("y = k * u\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(SETTINGS, encoding="utf-8")
    shift = "() => document.querySelector('input[aria-label=\"Shift of m\"]').value"
    with project_page(tmp_path / "kennfeld.toml", "data") as page:
        page.wait_for_selector(".data .heads > span:text-is('c.csv')")  # the scale of the files is known
        box = page.locator("tr[data-channel=m] td.line").bounding_box()
        page.mouse.move(box["x"] + 20, box["y"] + 10)
        page.mouse.down()
        page.mouse.move(box["x"] + 30, box["y"] + 10, steps=2)
        page.mouse.up()
        page.wait_for_function(f"{shift} !== ''")
        shifted = float(page.evaluate(shift))
        assert shifted > 0
        assert shifted / 0.1 == pytest.approx(round(shifted / 0.1))  # whole samples
        page.wait_for_selector(READY)
        page.click("#undo")
        page.wait_for_function(f"{shift} === ''")
