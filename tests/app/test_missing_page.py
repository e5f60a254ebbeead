"""The page of missing terms in a browser: a term is looked for, put at an equal place, applied and undone."""

from pathlib import Path

from tests.app.browser import READY
from tests.app.shared_app import project_page
from tests.project.test_missing_terms import write_bench


def test_a_term_is_looked_for_placed_applied_and_undone(tmp_path: Path) -> None:
    project = write_bench(tmp_path, samples=60)
    with project_page(project, "plots") as page:
        page.click("[data-ask=missing]")
        page.wait_for_selector("#nothing-asked")
        assert page.is_disabled("[data-take='channels.m']")  # the target
        page.uncheck("[data-take='kinds.multiply']")
        page.uncheck("[data-take='channels.humidity']")
        page.click("#look")
        page.wait_for_selector("#verdict")
        page.wait_for_selector("[data-proposal='0'][aria-pressed=true] h3:has-text('curve of oil')")
        assert "1 proposal" in page.inner_text("[data-screen=missing]")
        assert page.locator("#held-out tbody tr").count() == 3
        page.wait_for_selector("#term-change .add")
        page.click(".eqv [data-place]:has-text('to drag')")
        page.wait_for_selector("#term-change .add:has-text('AddDragOil(oil)')")
        page.click("#apply-term")
        page.wait_for_selector("#terms-old")
        assert page.is_disabled("#apply-run")
        page.keyboard.press("Control+z")
        page.wait_for_selector("#terms-old", state="detached")
        page.wait_for_selector("#apply-run:enabled")
        page.wait_for_selector(READY)
    assert (tmp_path / "f.kf").read_text(encoding="utf-8").count("oil") == 0  # nothing was saved
