"""The screen of the data: files, their channels, and what the function reads."""

from pathlib import Path

import pytest

from tests.app.shared_app import project_page
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
        page.wait_for_selector(".mapping td:has-text('1.000 … 9.000')")


def test_the_error_of_a_log_without_a_database_fits_the_page(tmp_path: Path) -> None:
    write_mf4(tmp_path / "drive.mf4", drive())
    project = write_project(tmp_path, '[[dataset]]\nfiles = ["drive.mf4"]\n')
    with project_page(project) as page:
        page.click("[data-screen=data]")
        box = page.wait_for_selector("td.fault:has-text('in the app, drop it on the page')").bounding_box()
        assert box["x"] + box["width"] <= 1280
        box = page.wait_for_selector("button[aria-label='Remove drive.mf4']").bounding_box()
        assert box["x"] + box["width"] <= 1280
