"""One server that tests use one after another, each with a project of its own in it.

Nothing of a project outlasts the next one that is opened, but the list of recent projects and what the user allowed to
run. Tests of these, of the start page, and those that end their server start one of their own (`browser.started`).
"""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from tests.app.app_processes import FORKS
from tests.app.browser import READY, browser_page
from tests.app.serving import Served, served


@cache
def shared_app() -> tuple[Served, ExitStack]:
    """Return the server of this process, started once, and what ends it."""
    stack = ExitStack()
    home = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    prelude = "from tests.app.app_processes import fork_own_workers; fork_own_workers()" if FORKS else ""
    return stack.enter_context(served(None, home, prelude)), stack


def end_shared_app() -> None:
    if shared_app.cache_info().currsize:
        _, stack = shared_app()
        shared_app.cache_clear()
        stack.close()


@contextmanager
def project_page(project: Path, screen: str = "") -> Iterator[Any]:
    """Open a project in the shared server, and a screen of it in the browser."""
    server, _ = shared_app()
    try:
        with server.page() as page:
            answer, _ = page.ask("open", path=str(project))
        assert "error" not in answer, answer
        with browser_page(f"http://{server.host}/?token={server.token}") as page:
            if screen:
                page.click(f"[data-screen={screen}]")
                page.wait_for_selector(READY)
            yield page
    except BaseException:
        end_shared_app()  # what a failed test leaves reaches no other
        raise
