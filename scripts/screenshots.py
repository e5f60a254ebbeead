"""Makes the pictures of the app in `docs/images`: `python scripts/screenshots.py` (needs Chromium and playwright)."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from kennfeld.project.demo import write

IMAGES = Path(__file__).parents[1] / "docs" / "images"
READY = "html[data-state=ready]"
SIZE = {"width": 1280, "height": 800}


def main() -> None:
    """Calibrate the exhaust demo in the app and take a picture of each step."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        project = write("exhaust", Path(folder) / "exhaust-sensor")
        command = [sys.executable, "-m", "kennfeld", "app", str(project), "--no-browser"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        try:
            address = server.stdout.readline().split()[-1]
            page = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"]).new_page(viewport=SIZE)
            page.goto(address)
            page.wait_for_selector(READY)
            _take_all(page)
        finally:
            server.terminate()


def _take_all(page: Any) -> None:
    page.click("#run")
    page.wait_for_selector("#job-state.converged", timeout=60_000)
    page.click("[data-screen=parameters]")
    page.click("[data-cell='7,8']")
    page.keyboard.type("790")
    page.keyboard.press("Enter")
    _take(page, "app-parameters")
    page.keyboard.press("Control+z")
    page.click("[data-screen=plots]")
    page.keyboard.press("b")
    page.wait_for_timeout(500)
    page.mouse.move(500, 300)
    page.mouse.down()
    page.mouse.move(580, 300, steps=5)
    page.mouse.up()
    _take(page, "app-plots")
    page.click("[data-screen=results]")
    _take(page, "app-results")


def _take(page: Any, name: str) -> None:
    page.wait_for_timeout(1200)
    page.wait_for_selector(READY)
    page.screenshot(path=str(IMAGES / f"{name}.png"))


if __name__ == "__main__":
    main()
