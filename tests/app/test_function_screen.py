"""The Function screen in a browser: formula text, a Simulink model, and a data-driven model."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import READY, browser_page, started

EXAMPLE = Path(__file__).parents[2] / "examples" / "simulink"


@contextmanager
def function_screen(project: Path) -> Iterator[Any]:
    """Open the Function screen of a project."""
    with started(project, project.parent) as (address, _), browser_page(address) as page:
        page.click("[data-screen=function]")
        page.wait_for_selector(READY)
        yield page


def row(page: Any, table: str) -> list[str]:
    """Return the cells of the correction of a table."""
    return list(page.locator(f"[data-split=corrections] tr:has-text('{table}') td").all_inner_texts())


def test_the_error_at_the_worst_point_is_split(torque: Path) -> None:
    with function_screen(torque) as page:
        page.wait_for_selector("[data-split=error]")
        page.click("button:text-is('Worst')")
        page.wait_for_selector("[data-worst] tr.on")
        page.wait_for_selector(READY)
        worst = page.locator("[data-worst] tbody tr").first
        assert page.inner_text("[data-split=error]")[:4] == worst.locator("td").last.inner_text()[:4]
        assert "out of reach" in row(page, "CurveEtaDeltaSpark")
        page.click("[data-node=etaSpark]")
        page.wait_for_selector("[data-split=corrections] tr.on:has-text('CurveEtaDeltaSpark')")
        before = page.inner_text(".io .sub >> nth=0")
        page.keyboard.press("Alt+ArrowDown")
        page.wait_for_function("text => document.querySelector('.io .sub').textContent !== text", arg=before)
        page.click("[data-split=corrections] button:text-is('MapOptTorque')")
        page.wait_for_selector("[data-cell]")


def test_a_misspelt_table_is_underlined_and_corrected(torque: Path) -> None:
    with function_screen(torque) as page:
        editor = page.locator(".cm-content")
        editor.click()
        page.keyboard.press("Control+End")
        page.keyboard.type("8 limited = min(TorquePredict, MapOptTorqe(Speed, Rel_Airmass))")
        page.wait_for_selector(".cm-lintRange-error:has-text('MapOptTorqe')")
        page.click(".cks button.plain")
        page.wait_for_function("() => document.activeElement.closest('.cm-editor') !== null")
        page.click(".cks button:text-is('Use MapOptTorque')")
        page.wait_for_selector(".node-now >> nth=7")
        page.wait_for_selector(READY)
        assert page.locator(".cks .ck").count() == 0
        assert "MapOptTorque(Speed, Rel_Airmass))" in editor.inner_text()


def test_a_simulink_model_is_unbound_bound_and_converted(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLE, tmp_path / "sensor")
    with function_screen(tmp_path / "sensor" / "kennfeld.toml") as page:
        page.click("[data-block='Sensor/Radiation']")
        page.wait_for_selector(".lit-line:has-text('Radiation = 0.15 * (t_wand - 20)')")
        page.click("[aria-label='Remove the binding of Sensor/Radiation']")
        page.click("[data-blocking='Sensor/Radiation'] .btn")
        page.fill("#binding", "0.15 * (t_wund - 20)")
        page.wait_for_selector(".binding:has-text('Did you mean t_wand?')")
        page.fill("#binding", "0,15 * (")
        page.wait_for_selector(".binding [role=alert]")
        page.fill("#binding", "0.2 * (t_wand - 20)")
        page.wait_for_selector(".binding:has-text('reads the channel t_wand')")
        page.click(".binding button:text-is('Bind')")
        page.wait_for_selector(".lit-line:has-text('Radiation = 0.2 * (t_wand - 20)')")
        page.focus("[role=tree]")
        page.keyboard.press("Home")
        page.wait_for_selector("[data-block=Speed][aria-selected=true]")
        page.click("[data-block='Sensor/Element']")
        page.keyboard.press("p")
        page.wait_for_selector(".import tr:has-text('Sensor/Element:InitialCondition')")
        page.click("#undo")
        page.wait_for_selector(".import tr:has-text('Sensor/Element:InitialCondition')", state="detached")
        page.select_option("#part", "Gas")
        page.wait_for_selector("[data-block=MapGas]")
        page.click("#undo")
        page.wait_for_selector("[data-block='Gas/MapGas']")
        page.click("button:text-is('Edit as formula text')")
        page.wait_for_selector(".cm-content:has-text('converted by Kennfeld')")
        page.select_option("[aria-label='File of the function']", "exhaust.mdl")
        page.wait_for_selector("[role=tree]")


def test_a_broken_model_is_one_message_and_the_page_lives_on(torque: Path) -> None:
    broken = torque.parent / "engine.slx"
    broken.write_text("not a model")
    with function_screen(torque) as page:
        page.select_option("[aria-label='File of the function']", "engine.slx")
        page.wait_for_selector(".import .note.bad")
        assert "is not a Simulink file" in page.inner_text(".import .note.bad")
        page.select_option("[aria-label='File of the function']", "torque.kf")
        page.wait_for_selector("[data-split=error]")


def test_a_dropped_model_becomes_the_function(torque: Path) -> None:
    with function_screen(torque) as page:
        page.set_input_files(".choice input[type=file]", EXAMPLE / "exhaust.mdl")
        page.wait_for_selector("[data-blocking='Sensor/Radiation']")
        assert page.locator("[data-missing]").count() == 3
        page.set_input_files(".state .head input[type=file]", EXAMPLE / "exhaust.m")
        page.wait_for_selector(".chip:has-text('exhaust.m')")
        page.wait_for_selector("[data-missing]", state="detached")


def test_a_project_begins_with_a_model(tmp_path: Path) -> None:
    with started(None, tmp_path) as (address, _), browser_page(address) as page:
        page.set_input_files("#drop input", str(EXAMPLE / "exhaust.mdl"))
        page.wait_for_selector(READY)
        page.click("[data-screen=function]")
        page.wait_for_selector("[data-blocking='Sensor/Radiation']")
    assert 'file = "exhaust.mdl"' not in (tmp_path / "exhaust" / "kennfeld.toml").read_text("utf-8")  # not saved yet
    assert (tmp_path / "exhaust" / "exhaust.mdl").is_file()


def test_a_data_driven_model_is_trained(torque: Path) -> None:
    with function_screen(torque) as page:
        page.click("[data-fold=surrogates] > button")
        page.click("text=New data-driven model")
        page.fill("[aria-label='Name of the model']", "engine")
        page.select_option("[aria-label=Output]", "Torque")
        for name in ("Speed", "Rel_Airmass"):
            page.click(f".new-surrogate .chip:text-is('{name}')")
        page.click(".new-surrogate button:text-is('Create')")
        page.wait_for_selector("[data-surrogate=engine] .stop")
        page.click("[data-screen=parameters]")  # nothing waits for the training
        page.wait_for_selector("[data-cell]")
        page.click("[data-screen=function]")
        page.wait_for_selector("[data-surrogate=engine] .tag.g", timeout=120_000)
        assert page.locator("[data-surrogate=engine] table tbody tr").count() == 3
