"""Several projects in one server: one after another in a page, and side by side in two."""

from pathlib import Path

import pytest

from tests.app.browser import READY
from tests.app.shared_app import project_page

SCREENS = ("data", "function", "parameters", "optimization", "results", "plots", "files", "control-unit")
OF_TORQUE = ("TorquePredict", "MapOptTorque", "CurveEta", "bench")
OF_EXHAUST = ("MapSettled", "TimeConstant", "drive.csv")


def create(name: str, folder: Path) -> Path:
    """Write an empty project and return its file."""
    (folder / name).mkdir()
    (folder / name / "function.kf").write_text("# empty\n")
    (folder / name / "kennfeld.toml").write_text('[model]\nfile = "function.kf"\n')
    return folder / name / "kennfeld.toml"


def test_a_screen_and_its_project_have_an_address_that_a_reload_and_back_show_again(torque: Path) -> None:
    with project_page(torque, "plots") as page:
        page.click("[data-screen=parameters]")
        page.click("[data-parameter=CurveEtaDeltaSpark]")
        assert page.url.split("#")[1].startswith("/torque-")
        assert page.url.endswith("/parameters/CurveEtaDeltaSpark")
        page.reload()
        page.wait_for_selector(READY)
        page.wait_for_selector("[data-parameter=CurveEtaDeltaSpark][aria-pressed=true]")
        page.go_back()
        page.wait_for_selector("[data-screen=plots][aria-current=page]")


@pytest.mark.slow
def test_nothing_of_a_project_is_shown_in_the_next_one(torque: Path, exhaust: Path, tmp_path: Path) -> None:
    with project_page(torque, "function") as page:
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=60_000)
        foreign: tuple[str, ...] = OF_TORQUE
        for project in (exhaust, create("empty", tmp_path)):
            for screen in SCREENS:  # each has asked for what it shows
                page.click(f"[data-screen={screen}]")
                page.wait_for_selector(READY)
            page.click("[data-screen=start]")
            page.fill("[aria-label='Path of a project']", str(project))
            page.click("form:has([aria-label='Path of a project']) button")
            if page.is_visible("#leave-keep"):
                page.click("#leave-keep")
            page.wait_for_function("name => location.hash.startsWith('#/' + name)", arg=project.parent.name)
            for screen in SCREENS:
                page.click(f"[data-screen={screen}]")
                page.wait_for_selector(READY)
                text = page.inner_text("body")
                assert not [name for name in foreign if name in text], (project.parent.name, screen)
                assert "Run 1" not in text
            foreign = OF_TORQUE + OF_EXHAUST


@pytest.mark.slow
def test_two_tabs_show_two_projects(torque: Path, exhaust: Path) -> None:
    with project_page(torque) as page:
        before = page.inner_text("#rmse-training")
        other = page.context.new_page()
        other.goto(page.url)
        other.wait_for_selector(READY)
        other.click("[data-screen=start]")
        other.fill("[aria-label='Path of a project']", str(exhaust))
        other.click("form:has([aria-label='Path of a project']) button")
        other.wait_for_selector("[data-parameter=MapSettled]")
        other.click("[data-cell='0,0']")
        other.keyboard.type("300")
        other.keyboard.press("Enter")
        other.wait_for_selector("small.dirty")
        assert page.inner_text("#rmse-training") == before
        assert page.is_visible("[data-parameter=MapOptTorque]")
        assert "1 unsaved" not in page.inner_text("header")
