"""A headless browser on a served project."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

LAUNCH = "from pathlib import Path; from kennfeld.app.launch import launch; launch({project}, 0, browser=False)"
ARGUMENTS = ["--headless", "--no-sandbox", "--disable-gpu"]
READY = "html[data-state=ready]"
ENDED = ("WebSocket", "ERR_CONNECTION_REFUSED")  # what the console says of a server that a test has ended


def chromium() -> str:
    """Return the path of a browser, or skip the test."""
    for name in ("chromium", "chromium-browser", "google-chrome", "chrome"):
        if path := shutil.which(name):
            return path
    pytest.skip("no Chromium on this machine")


@cache
def browser() -> Any:
    """Return the browser of this process, started once."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = chromium()
    return api.sync_playwright().start().chromium.launch(executable_path=path, args=ARGUMENTS)


@contextmanager
def started(project: Path | None, folder: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Start the app in a folder, with a home of its own; yields its address and its process."""
    code = LAUNCH.format(project=f"Path({str(project)!r})" if project else "None")
    environment = {**os.environ, "HOME": str(folder), "USERPROFILE": str(folder)}
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder, env=environment)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("Kennfeld runs at http://127.0.0.1:")
        yield line.split()[-1], process
    finally:
        process.terminate()
        process.wait(timeout=20)
        process.stdout.close()


@contextmanager
def browser_page(address: str, size: Sequence[int] = (1280, 800)) -> Iterator[Any]:
    """Open an address; errors on the page's console fail the test."""
    context = browser().new_context(viewport={"width": size[0], "height": size[1]})
    try:
        page = context.new_page()
        problems: list[str] = []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        page.goto(address)
        page.wait_for_selector(READY)
        yield page
        unexpected = [each for each in problems if not any(word in each for word in ENDED)]
        assert not unexpected, unexpected
    finally:
        context.close()


@contextmanager
def function_screen(project: Path) -> Iterator[Any]:
    """Open the Function screen of a project."""
    with started(project, project.parent) as (address, _), browser_page(address) as page:
        page.click("[data-screen=function]")
        page.wait_for_selector(READY)
        yield page
