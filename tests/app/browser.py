"""A headless browser on a served project."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.app.app_processes import AppProcess, app_process

ARGUMENTS = ["--headless", "--no-sandbox", "--disable-gpu"]
READY = "html[data-state=ready]"
ENDED = (
    "WebSocket",
    "ERR_CONNECTION_REFUSED",
    "ERR_CONNECTION_RESET",
)  # what the console says of a server that a test has ended


def chromium() -> str:
    """Return the path of a browser, or skip the test."""
    for name in ("chromium", "chromium-browser", "google-chrome", "chrome"):
        if path := shutil.which(name):
            return path
    pytest.skip("no Chromium on this machine")


class SharedBrowser:
    """A browser and its tab, which tests use one after another.

    A tab of its own for each test takes several processes, and four times as long to show a page.
    """

    def __init__(self) -> None:
        api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
        path = chromium()
        self._playwright = api.sync_playwright().start()
        self._browser = self._playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        self._tab: Any = None

    @contextmanager
    def tab(self, size: Sequence[int], theme: str) -> Iterator[Any]:
        """Lend the tab; a test that fails closes it."""
        if self._tab is None:
            self._tab = self._browser.new_context().new_page()
        tab, self._tab = self._tab, None
        try:
            tab.set_viewport_size({"width": size[0], "height": size[1]})
            tab.emulate_media(color_scheme=theme)
            yield tab
            self._leave(tab)
            self._tab = tab
        finally:
            if self._tab is None:
                tab.context.close()

    def _leave(self, tab: Any) -> None:
        """End the page in the tab, and forget what it has stored."""
        for other in tab.context.pages:
            if other != tab:
                other.close()
        tab.mouse.move(0, 0)
        tab.evaluate("() => { localStorage.clear(); sessionStorage.clear(); location.replace('about:blank'); }")
        tab.wait_for_url("about:blank")  # a page that leaves by itself keeps its process for the next one
        tab.context.clear_cookies()

    def close(self) -> None:
        self._browser.close()
        self._playwright.stop()


@cache
def browser() -> SharedBrowser:
    """Return the browser of this process, started once."""
    return SharedBrowser()


def close_browser() -> None:
    if browser.cache_info().currsize:
        browser().close()
        browser.cache_clear()


@contextmanager
def tab(size: Sequence[int] = (1280, 800), theme: str = "light", expected: Sequence[str] = ()) -> Iterator[Any]:
    """Lend an empty tab; errors on its console fail the test, but for those that contain a word of `expected`."""
    problems: list[str] = []

    def note(message: Any) -> None:
        if message.type == "error":
            problems.append(message.text)

    def note_error(error: Any) -> None:
        problems.append(str(error))

    with browser().tab(size, theme) as page:
        page.on("pageerror", note_error)
        page.on("console", note)
        try:
            yield page
        finally:
            page.remove_listener("pageerror", note_error)
            page.remove_listener("console", note)
    unexpected = [each for each in problems if not any(word in each for word in expected)]
    assert not unexpected, unexpected


@contextmanager
def started(project: Path | None, folder: Path, *, fresh: bool = False) -> Iterator[tuple[str, AppProcess]]:
    """Start the app in a folder, with a home of its own; yields its address and its process."""
    with app_process(project, folder, folder, fresh=fresh) as (line, process):
        assert line.startswith("Kennfeld runs at http://127.0.0.1:")
        yield line.split()[-1], process


@contextmanager
def browser_page(address: str, size: Sequence[int] = (1280, 800)) -> Iterator[Any]:
    """Open an address of the app."""
    with tab(size, expected=ENDED) as page:
        page.goto(address)
        page.wait_for_selector(READY)
        yield page
