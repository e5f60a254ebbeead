"""What screen readers and keyboards need, on every screen, as axe-core checks it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.app.browser import READY
from tests.app.shared_app import project_page

AXE = Path(__file__).parents[2] / "web" / "node_modules" / "axe-core" / "axe.min.js"
SCREENS = (
    "start",
    "data",
    "function",
    "parameters",
    "optimization",
    "results",
    "plots",
    "files",
    "missing",
    "design",
    "control-unit",
)
RUN = """async () => (await axe.run(document, { resultTypes: ["violations"] })).violations.map(
  (each) => `${each.id}: ${each.nodes.slice(0, 3).map((node) => node.html.slice(0, 120)).join(" | ")}`)"""

needs_axe = pytest.mark.skipif(not AXE.is_file(), reason="axe-core is not installed: run npm ci in web/")


def violations(page: Any) -> list[str]:
    """Return the rules that the page breaks, each with the first elements that do."""
    if not page.evaluate("() => 'axe' in window"):
        # by the debugger, as the page lets no other script run
        script = AXE.read_text(encoding="utf-8") + ";0"
        page.context.new_cdp_session(page).send("Runtime.evaluate", {"expression": script})
    violations: list[str] = page.evaluate(RUN)
    return violations


def shown(page: Any, screens: tuple[str, ...] = SCREENS) -> Iterator[tuple[str, list[str]]]:
    for screen in screens:
        page.click(f"[data-screen={screen}]")
        page.wait_for_selector(READY)
        if broken := violations(page):
            yield screen, broken


@needs_axe
@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_no_screen_breaks_a_rule_of_axe(torque: Path, theme: str) -> None:
    with project_page(torque) as page:
        if theme == "dark":
            page.click("#theme")
        assert dict(shown(page)) == {}


@needs_axe
@pytest.mark.slow
def test_settings_dialogs_and_messages_break_no_rule_of_axe(torque: Path) -> None:
    text = torque.read_text(encoding="utf-8")
    torque.write_text(text.replace('"bench.csv"', '"bensh.csv"'), encoding="utf-8")
    with project_page(torque, "data") as page:
        page.click("[data-settings=dataset]")
        page.wait_for_selector(READY)
        assert violations(page) == []
        for key in ("Control+k", "?"):
            page.keyboard.press(key)
            page.wait_for_selector("dialog[open]")
            assert violations(page) == []
            page.keyboard.press("Escape")
        assert dict(shown(page, SCREENS[1:])) == {}


@needs_axe
@pytest.mark.slow
def test_the_screens_after_a_run_break_no_rule_of_axe(torque: Path) -> None:
    with project_page(torque, "optimization") as page:
        page.click("#run")
        page.wait_for_function("() => !['idle', 'running'].includes(document.getElementById('job-state').innerText)")
        page.wait_for_selector(READY)
        assert dict(shown(page, ("optimization", "results", "parameters", "plots", "control-unit"))) == {}


@needs_axe
@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_platforms_of_an_fmu_break_no_rule_of_axe(exhaust: Path, theme: str) -> None:
    with project_page(exhaust, "control-unit") as page:
        if theme == "dark":
            page.click("#theme")
        page.wait_for_selector(".platforms label")
        assert violations(page) == []
        # as they are where a compiler for other platforms is installed
        page.eval_on_selector_all(
            ".platforms label", "all => all.forEach(e => { e.className = ''; e.firstElementChild.disabled = false; })"
        )
        assert violations(page) == []
