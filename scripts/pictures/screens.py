"""The screens of the app with the exhaust demo, and its report."""

import tempfile
from pathlib import Path
from typing import Any

from scripts.pictures import demos
from scripts.pictures.browser import READY, SIZE, open_app, open_browser, take

import kennfeld as kf
from kennfeld.project.demo import write


def make() -> None:
    """Calibrate the demo in the app and take a picture of each step."""
    with tempfile.TemporaryDirectory() as folder:
        project = write("exhaust", Path(folder) / "exhaust-sensor")
        with open_app(project) as page:
            _take_app(page)
    take_report()


def _take_app(page: Any) -> None:
    page.click("#run")
    page.wait_for_selector("#job-state.converged", timeout=60_000)
    _show(page, "data", 560)
    _take(page, "app-data")
    _show(page, "function")
    page.click("text=Worst >> nth=0")
    _take(page, "app-function")
    _show(page, "parameters")
    page.click("[data-cell='7,8']")
    page.keyboard.type("790")
    page.keyboard.press("Enter")
    _take(page, "app-parameters")
    page.keyboard.press("Control+z")
    _show(page, "plots")
    page.keyboard.press("b")
    page.wait_for_timeout(500)
    page.mouse.move(500, 300)
    page.mouse.down()
    page.mouse.move(580, 300, steps=5)
    page.mouse.up()
    _take(page, "app-plots")
    _show(page, "results", 720)
    page.click("text=MapSettled >> nth=0")
    _take(page, "app-results")


def _show(page: Any, screen: str, height: int = SIZE["height"]) -> None:
    """Go to a screen, as high as what it shows."""
    page.set_viewport_size(SIZE | {"height": height})
    page.click(f"[data-screen={screen}]")


def _take(page: Any, name: str) -> None:
    page.wait_for_timeout(1200)
    page.wait_for_selector(READY)
    take(page, name)


def take_report() -> None:
    """Take a picture of the report of the torque demo."""
    project, result = demos.project("torque"), demos.result("torque")
    with tempfile.TemporaryDirectory() as folder, open_browser() as page:
        path = Path(folder) / "report.html"
        path.write_text(kf.report.document(project, result, project.check()), encoding="utf-8")
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-ready=yes]")
        box = page.locator("section").first.bounding_box()
        page.wait_for_timeout(1200)
        take(page, "report", clip={key: round(value) for key, value in box.items()})
        page.evaluate("document.querySelector('#parameter-0').scrollIntoView()")
        page.wait_for_timeout(1200)
        take(page, "report-parameters", clip={"x": 0, "y": 0, "width": SIZE["width"], "height": 720})
