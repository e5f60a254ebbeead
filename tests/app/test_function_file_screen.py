"""Functions in files of other tools on the Function screen in a browser, and the consent to run their code."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.app.browser import READY, browser_page, started
from tests.app.function_samples import C_FILE, write_functions
from tests.app.shared_app import project_page
from tests.importers.fmu.lag_fmu import build

ALLOW = ".consent button.primary"


@contextmanager
def function_screen(project: Path) -> Iterator[Any]:
    """Open the Function screen of a project in a server of its own, whose user has allowed nothing."""
    with started(project, project.parent) as (address, _), browser_page(address) as page:
        page.click("[data-screen=function]")
        page.wait_for_selector(READY)
        yield page


@pytest.mark.slow
def test_a_project_begins_with_a_c_file_whose_function_is_chosen(tmp_path: Path) -> None:
    (tmp_path / "drop").mkdir()
    source = tmp_path / "drop" / "engine.c"
    source.write_text(C_FILE)
    with started(None, tmp_path) as (address, _), browser_page(address) as page:
        page.set_input_files("#drop input", str(source))
        page.wait_for_selector(".tag:text-is('choose a function')")
        assert "static double y;" in page.inner_text("[aria-label='Source text']")
        page.select_option("[aria-label='Function of the file']", "lag")
        page.wait_for_selector(".tag.g:text-is('can be calibrated')")
        assert page.inner_text(".ascet .lit-line code") == "double lag(double x, double T, double dt)"
        assert page.locator("[aria-label='Channel of x']").count() == 1
        assert page.locator("[aria-label='Channel of dt']").count() == 0  # the step
        page.click("button:text-is('Edit as formula text')")
        page.wait_for_selector(".cm-content:has-text('output lag')")


@pytest.mark.slow
def test_an_error_in_a_c_file_is_shown_at_its_line(tmp_path: Path) -> None:
    project = write_functions(tmp_path, file="engine.c:twice")
    (tmp_path / "engine.c").write_text(C_FILE.replace("return 2 * x;", "goto end; end: return x;"))
    with project_page(project, "function") as page:
        page.wait_for_selector(".ascet .blocks .ln.wrong:has-text('goto end')")
        page.click(".import .note.bad button:has-text('goto')")
        page.wait_for_selector(".ascet .blocks .ln.wrong.lit-line:has-text('goto end')")
        assert page.is_disabled("button:text-is('Edit as formula text')")


@pytest.mark.slow
def test_a_python_function_runs_once_it_is_allowed(tmp_path: Path) -> None:
    project = write_functions(tmp_path, "y = K * table(u)\n", '[functions]\ntable = "table.py:table"')
    with function_screen(project) as page:
        page.wait_for_selector(".consent:has-text('runs code of table.py')")
        page.click("[data-fold=functions] > button")
        page.wait_for_selector("[data-called=table] .tag:text-is('runs code')")
        page.click("[data-screen=parameters]")
        page.wait_for_selector(".notices .consent")
        assert not (tmp_path / "ran").exists()
        page.click(ALLOW)
        page.wait_for_selector(".consent", state="detached")
        page.wait_for_selector("#rmse-training:not(:has-text('–'))")
        assert (tmp_path / "ran").exists()
    with function_screen(project) as page:
        assert page.locator(".consent").count() == 0  # what was allowed is remembered


@pytest.mark.slow
def test_an_fmu_is_dropped_and_allowed(tmp_path: Path) -> None:
    project = write_functions(tmp_path / "project")
    file = build(tmp_path, 2)
    with function_screen(project) as page:
        page.set_input_files(".choice input[type=file]", str(file))
        page.wait_for_selector(".ascet .facts:has-text('FMI 2.0 for model exchange')")
        page.wait_for_selector(".import tr:has-text('map 2 × 3')")
        assert "solver ode4" in page.inner_text(".import .note:has-text('Runs with')")
        assert page.is_disabled("button:text-is('Edit as formula text')")
        page.click(ALLOW)
        page.wait_for_selector(".split tr:has-text('Nm')")
        page.click(".import button:text-is('tau')")
        page.wait_for_selector("[data-screen=parameters][aria-current]")


@pytest.mark.slow
def test_a_network_is_chosen_and_its_layers_are_listed(tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    from tests.importers.onnx.networks import perceptron, random_layers

    project = write_functions(tmp_path)
    perceptron(tmp_path / "net.onnx", random_layers([2, 3, 1]))
    with project_page(project, "function") as page:
        page.select_option("[aria-label='File of the function']", "net.onnx")
        page.wait_for_selector(".ascet .facts:has-text('2 operators')")
        page.fill("[aria-label='Channel of x[0]']", "u")
        page.keyboard.press("Tab")
        page.wait_for_selector(".import tr:has-text('x[0]') svg.good")
        assert page.locator(".import tr:has-text('block')").count() == 2
        assert page.locator(".consent").count() == 0


@pytest.mark.slow
def test_a_file_is_added_and_its_function_is_called_by_completion(tmp_path: Path) -> None:
    project = write_functions(tmp_path / "project")
    (tmp_path / "shape.py").write_text("def shape(x, width=2.0):\n    return x / width\n")
    (tmp_path / "filters.c").write_text(C_FILE)
    with project_page(project, "function") as page:
        page.click("[data-fold=functions] > button")
        page.set_input_files(
            "[aria-label='Files of functions']", [str(tmp_path / "shape.py"), str(tmp_path / "filters.c")]
        )
        page.wait_for_selector("[data-called=shape] .mono:text-is('shape(x, width=2.0)')")
        page.select_option("[aria-label='Function of filters']", "twice")
        page.wait_for_selector("[data-called=filters] .mono:text-is('filters(x)')")
        page.click(".cm-content")
        page.keyboard.press("Control+End")
        page.keyboard.type("z = sha")
        page.click(".cm-tooltip-autocomplete li:has-text('shape(x, width=2.0)')")
        page.keyboard.type("u) + filters(u)")
        page.wait_for_selector(".node-now >> nth=1")
        page.wait_for_selector(READY)
        assert "z = shape(u) + filters(u)" in page.inner_text(".cm-content")
        page.click("[aria-label='Remove shape']")
        page.wait_for_selector("[data-called=shape]", state="detached")
        page.wait_for_selector(".cks:has-text('shape')")
        page.click("#undo")
        page.wait_for_selector("[data-called=shape]")
    assert (project.parent / "shape.py").is_file()
