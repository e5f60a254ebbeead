"""The page into the control unit in a browser: steps, rounding, code, and files that are replaced on confirmation."""

from pathlib import Path

import numpy as np

from kennfeld.calfiles import read
from tests.app.browser import READY
from tests.app.function_samples import write_product
from tests.app.shared_app import project_page


def test_values_are_rounded_shown_as_code_and_written_together(tmp_path: Path) -> None:
    project = write_product(tmp_path / "product")
    with project_page(project, "control-unit") as page:
        name = page.get_attribute("#storage tbody tr", "data-label")
        page.wait_for_selector("#no-steps")
        page.wait_for_selector("#c-code:has-text('exported by Kennfeld')")  # the values as they are
        page.fill(f"[aria-label='Step of {name}']", "0.5")
        page.keyboard.press("Enter")
        page.wait_for_selector("#write-unit:has-text('Round first')")
        page.click("#round")
        page.wait_for_selector("#rounding-errors tbody tr")
        page.wait_for_selector("#unit-busy", state="detached")
        page.wait_for_selector("#write-unit:enabled")
        page.click("[data-language=c] input")  # no compiler is needed
        page.check("[data-format=json] input")
        page.click("#write-unit")
        page.wait_for_selector("#written-unit:has-text('parameters.json')")
        target = project.parent / "export" / "parameters.json"
        values = read(target)[name].values
        np.testing.assert_array_equal(values, 0.5 * np.rint(values / 0.5))
        target.write_text("{}", encoding="utf-8")
        page.click("#write-unit")
        page.wait_for_selector("#existing:has-text('parameters.json')")
        assert target.read_text(encoding="utf-8") == "{}"
        page.click("#replace-unit")
        page.wait_for_selector("#existing", state="detached")
        page.wait_for_selector(READY)
    np.testing.assert_array_equal(read(target)[name].values, values)
