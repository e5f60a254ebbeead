"""The screen of calibration files in a browser: compare, take, undo, merge, convert."""

from pathlib import Path

import pytest

import kennfeld as kf
from kennfeld.project import Project
from tests.app.browser import READY, browser_page, started
from tests.app.function_samples import write_product
from tests.app.shared_app import project_page


@pytest.fixture
def bench(torque: Path) -> Path:
    """Return a calibration file of the folder with another map."""
    own = Project.read(torque).problem().parameters
    table = own["MapOptTorque"]
    path = torque.parent / "bench.dcm"
    own.with_parameters(table.with_values(table.values + 3.0)).save(path)
    return path


@pytest.mark.slow
def test_a_file_is_compared_and_its_values_are_taken(torque: Path, bench: Path) -> None:
    with project_page(torque) as page:
        page.click("[data-screen=files]")
        page.click("[data-file='bench.dcm']")
        page.wait_for_selector("#differences [data-name=MapOptTorque]:has-text('3.000')")
        assert page.inner_text("#difference-count") == "1 of 4 names differ"
        page.click("#take-values")
        page.wait_for_selector("#difference-count:has-text('equal')")
        page.keyboard.press("Control+z")
        page.wait_for_selector("#differences [data-name=MapOptTorque]")


@pytest.mark.slow
def test_a_dropped_file_is_merged_and_converted(torque: Path, bench: Path, tmp_path: Path) -> None:
    own = kf.read_parameters(bench)
    outside = tmp_path / "tuned.json"
    own.with_parameters(own["MapOptTorque"].with_values(own["MapOptTorque"].values * 2)).save(outside)
    with project_page(torque) as page:
        page.click("[data-screen=files]")
        page.set_input_files(".fl input[type=file]", str(outside))
        page.wait_for_selector("[data-file='tuned.json'].on")
        page.wait_for_selector("#differences [data-name=MapOptTorque]")
        page.fill("#target-name", "both")
        page.select_option("#target-ending", ".cdfx")
        page.click("#write-file")
        page.wait_for_selector("#written:has-text('both.cdfx')")
        page.click("#write-file")
        page.wait_for_selector("#replace-file")
        page.click("#replace-file")
        page.wait_for_selector("#replace-file", state="detached")
        page.wait_for_selector(READY)
    merged = kf.read_parameters(torque.parent / "both.cdfx")
    assert merged["MapOptTorque"].values == pytest.approx(own["MapOptTorque"].values * 2)


@pytest.mark.slow
def test_a_file_that_is_dropped_on_the_start_page_makes_a_project(tmp_path: Path) -> None:
    rows = "\n".join(f"{x},{2 * x}" for x in range(50))
    (tmp_path / "bench.csv").write_text(f"Speed,Torque\nrpm,Nm\n{rows}\n")
    with started(None, tmp_path) as (address, _), browser_page(address) as page:
        page.set_input_files("#drop input", str(tmp_path / "bench.csv"))
        page.wait_for_selector(".files td:has-text('bench.csv')")
        page.click("[data-screen=start]")
        page.wait_for_selector("#recent tr:has-text('bench')")
    assert "bench.csv" not in (tmp_path / "bench" / "kennfeld.toml").read_text()  # until it is saved
    assert (tmp_path / "bench" / "bench.csv").is_file()


def test_a_file_name_with_markup_is_shown_as_text(torque: Path, bench: Path) -> None:
    name = "<img src=x onerror=document.title='hit'>.dcm"
    bench.rename(bench.with_name(name))
    with project_page(torque) as page:
        page.click("[data-screen=files]")
        page.wait_for_selector(".file-row:has-text('<img')")
        page.click(".file-row:has-text('<img')")
        page.wait_for_selector("#differences [data-name=MapOptTorque]")
        assert page.title() != "hit"
        assert page.query_selector("main img") is None


@pytest.mark.slow
def test_a_remedy_is_applied_with_one_click_and_undone(tmp_path: Path) -> None:
    with project_page(write_product(tmp_path / "product")) as page:
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=60_000)
        page.click("[data-screen=results]")
        page.click("#trust button[data-remedy] >> nth=0")
        page.wait_for_selector("#trust span[data-remedy]:has-text('applied')")
        page.keyboard.press("Control+z")
        page.wait_for_selector("#trust span[data-remedy]", state="detached")
        with page.expect_download() as download:
            page.click("#export-folder")
        assert download.value.suggested_filename == "product.zip"


@pytest.mark.slow
def test_a_choice_is_taken_into_the_present_values_with_the_error_that_was_shown(torque: Path) -> None:
    with project_page(torque) as page:
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=60_000)
        page.click("[data-screen=results]")
        page.wait_for_selector("#take[disabled]")  # now has these values already
        page.click("#undo")
        page.click("text=by parameter")
        page.click("[data-change=MapOptTorque] .tick")
        page.wait_for_selector("#take:has-text('Take 247 values of run 1 into now')")
        expected = page.inner_text("#then b >> nth=0")
        page.click("#take")
        page.wait_for_selector(f"#rmse-training:has-text('{expected}')")
