"""The page of what to measure next in a browser: from a sentence of the results to points, their maps and a file."""

from pathlib import Path

import pytest

from tests.app.browser import READY
from tests.app.function_samples import write_product
from tests.app.shared_app import project_page
from tests.app.test_design import write_map


def test_points_are_proposed_shown_and_exported(tmp_path: Path) -> None:
    project = write_map(tmp_path)
    with project_page(project, "design") as page:
        page.wait_for_selector("#nothing-proposed")
        page.fill("[aria-label=Points]", "4")
        page.keyboard.press("Enter")
        page.check("[data-determine=M]")
        page.click("#propose")
        page.wait_for_selector("#points tbody tr")
        assert page.locator("#points tbody tr").count() == 4
        assert "4 points" in page.inner_text("[data-screen=design]")
        page.wait_for_selector(".mpx[aria-label='Deviations as predicted'] canvas")
        page.wait_for_selector(READY)
        page.keyboard.press("ArrowDown")
        page.wait_for_selector("[data-point='1'].on")
        page.click("#export-design")
        page.wait_for_selector("#written-design")
        page.click("#export-design")
        page.wait_for_selector("#existing-design")
    assert (tmp_path / "measure-next.csv").is_file()


@pytest.mark.slow
def test_a_sentence_of_the_results_leads_to_its_points(tmp_path: Path) -> None:
    with project_page(write_product(tmp_path / "product"), "results") as page:
        page.keyboard.press("F5")
        page.wait_for_selector("#job-state.converged")
        page.click("#trust [data-settle='1']")
        page.wait_for_selector("[data-screen=design][aria-current]")
        assert page.input_value("[aria-label=Direction]") == "1"
        page.click("#propose")
        page.wait_for_selector("#points tbody tr")
        page.wait_for_selector("[data-unsettled]:has-text('settles that')")
        page.click("[data-unsettled] .btn")
        page.wait_for_selector("[data-screen=results][aria-current]")
