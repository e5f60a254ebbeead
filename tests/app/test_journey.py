"""Whole journeys in a headless browser."""

from pathlib import Path

import pytest

import kennfeld as kf
from tests.app.browser import READY, browser_page, started
from tests.app.shared_app import project_page


def rows_of_bench() -> str:
    """Return a recording as CSV: torque = 0.1 Speed + 2 Load."""
    lines = ["Speed,Load,Torque", "rpm,%,Nm"]
    lines += [
        f"{speed},{load},{0.05 * speed + 1.5 * load}" for speed in range(800, 4001, 200) for load in range(10, 101, 10)
    ]
    return "\n".join(lines)


def test_from_a_csv_to_a_dcm(tmp_path: Path) -> None:
    (tmp_path / "bench.csv").write_text(rows_of_bench())
    with started(None, tmp_path) as (address, process), browser_page(address) as page:
        page.fill("[aria-label='Name of the new project']", "sensor")
        page.click("text=Create")
        page.set_input_files("input[type=file]", str(tmp_path / "bench.csv"))
        page.wait_for_selector("text=170")
        page.click("[data-screen=function]")
        page.click(".cm-content")
        page.keyboard.type("torque[Nm] = MapTorque(Speed, Load) + offset")
        for proposal in ("map MapTorque over Speed, Load", "offset"):  # what was typed first has others
            page.wait_for_selector(f"#proposals:has-text('{proposal}')")
        page.click("#add-all")
        page.wait_for_selector("#proposals", state="detached")
        page.wait_for_selector("#rmse-training:has-text('Nm')")
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=60_000)
        assert float(page.inner_text("#rmse-training").split()[0]) < 0.01
        page.click("#save")
        page.wait_for_selector("#unsaved:not(.dirty)")
        page.click("[data-screen=results]")
        page.click("[data-format=dcm]")
        page.click("#export-files")
        page.wait_for_selector("text=parameters.dcm")
        process.terminate()
        process.wait()
    folder = tmp_path / "sensor"
    values = kf.read_parameters(folder / "results" / "parameters.dcm")
    assert values["MapTorque"].values.ndim == 2
    again = kf.Project.read(folder / "kennfeld.toml")
    assert not [finding for finding in again.check() if finding.severity == "error"]
    assert again.problem().parameters["MapTorque"].values == pytest.approx(values["MapTorque"].values, abs=1e-3)


@pytest.mark.slow
def test_the_same_project_on_the_command_line_gives_the_same_numbers(exhaust: Path) -> None:
    expected = kf.Project.read(exhaust).calibrate()
    training = next(row for row in expected.quality if row.use == "training")
    with project_page(exhaust) as page:
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=60_000)
        assert page.inner_text("#rmse-training") == f"{training.rmse_after:.3f} degC"


def test_typing_into_the_table_and_undo(torque: Path) -> None:
    with project_page(torque) as page:
        page.click("[data-parameter=MapOptTorque]")
        before = page.inner_text("#rmse-training")
        page.click("[data-cell='3,4']")
        page.keyboard.type("95,5")
        page.keyboard.press("Enter")
        page.wait_for_selector("#unsaved.dirty, small.dirty")
        page.wait_for_selector(READY)
        assert page.inner_text("[data-cell='3,4']") == "95.5"
        page.keyboard.press("Control+z")
        page.wait_for_function("before => document.querySelector('#rmse-training').innerText === before", arg=before)
        page.wait_for_selector("#undo[disabled]")


@pytest.mark.slow
def test_two_tabs_agree(torque: Path) -> None:
    with project_page(torque) as page:
        other = page.context.new_page()
        other.goto(page.url)
        other.wait_for_selector(READY)
        page.click("[data-cell='0,0']")
        page.keyboard.type("120")
        page.keyboard.press("Enter")
        other.wait_for_selector("[data-cell='0,0']:has-text('120')")
        assert other.inner_text("#rmse-training") == page.inner_text("#rmse-training")


@pytest.mark.slow
def test_a_file_that_changes_on_disk_is_noticed(torque: Path) -> None:
    with project_page(torque) as page:
        torque.write_text(
            torque.read_text(encoding="utf-8")
            .replace("smoothness = 10 ", "smoothness = 20 ")
            .replace("[optimizer]", "[optimizer]\nstarts = 3"),
            encoding="utf-8",
        )
        page.wait_for_selector("#changed-on-disk:has-text('kennfeld.toml has another content')")
        page.click("text=Read again")
        page.wait_for_selector("#changed-on-disk", state="detached")


@pytest.mark.slow
def test_unsaved_edits_survive_the_end_of_the_server(torque: Path, tmp_path: Path) -> None:
    with started(torque, tmp_path, fresh=True) as (address, process), browser_page(address) as page:
        page.click("[data-cell='1,1']")
        page.keyboard.type("99")
        page.keyboard.press("Enter")
        page.wait_for_selector("small.dirty")
        process.kill()
        page.wait_for_selector("text=does not answer")
    with project_page(torque) as page:
        page.click("text=Recover")
        page.wait_for_selector("[data-cell='1,1']:has-text('99')")


SCREENS = ("data", "function", "parameters", "optimization", "results", "plots", "files", "control-unit", "start")


def test_every_screen_opens_with_a_heading_of_its_own_and_the_page_never_scrolls(exhaust: Path) -> None:
    headings = []
    with project_page(exhaust) as page:
        for screen in SCREENS:
            page.click("#theme")  # each screen in another than the one before
            page.click(f"[data-screen={screen}]")
            page.wait_for_selector(READY)
            for width, height in ((1280, 800), (1920, 1080)):
                page.set_viewport_size({"width": width, "height": height})
                page.wait_for_function("document.documentElement.scrollHeight <= innerHeight")
            assert page.inner_text("main").strip() != ""
            headings.append(page.inner_text("h1"))
        assert page.title() == "exhaust – Kennfeld"
    assert headings[0] == "Data, exhaust, Kennfeld"
    assert len(set(headings)) == len(SCREENS)


@pytest.mark.slow
def test_the_palette_finds_a_parameter(torque: Path) -> None:
    with project_page(torque) as page:
        page.keyboard.press("Control+k")
        page.wait_for_selector("[aria-label='Command or parameter']:focus")
        page.keyboard.type("eta")
        page.keyboard.press("Enter")
        page.wait_for_selector("[data-parameter=CurveEtaDeltaSpark][aria-pressed=true]")
        page.click("[data-cell='0,0']")
        before = page.inner_text("[data-cell='0,0']")
        page.keyboard.press("?")
        page.wait_for_selector("[aria-label=Keys]")
        for key in ("5", "Delete", "Tab", "Tab", "Tab", "+"):  # reach nothing behind the dialog
            page.keyboard.press(key)
            assert page.evaluate("document.activeElement.closest('dialog, body').tagName") == "DIALOG"
        assert page.inner_text("[data-cell='0,0']") == before
        assert page.is_disabled("#undo")
        page.keyboard.press("Escape")
        page.wait_for_selector("[aria-label=Keys]", state="detached")
