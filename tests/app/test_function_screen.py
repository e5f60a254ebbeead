"""The Function screen in a browser: formula text, a Simulink model, and a data-driven model."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.app.browser import READY, browser_page, started
from tests.app.shared_app import project_page
from tests.importers.ascet.esdl_projects import BATTERY, LIBRARY, write_project

EXAMPLE = Path(__file__).parents[2] / "examples" / "simulink"


def row(page: Any, table: str) -> list[str]:
    """Return the cells of the correction of a table."""
    return list(page.locator(f"[data-split=corrections] tr:has-text('{table}') td").all_inner_texts())


@pytest.mark.slow
def test_the_error_at_the_worst_point_is_split(torque: Path) -> None:
    with project_page(torque, "function") as page:
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
    with project_page(torque, "function") as page:
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


@pytest.mark.guests
@pytest.mark.slow
def test_a_simulink_model_is_unbound_bound_and_converted(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLE, tmp_path / "sensor")
    with project_page(tmp_path / "sensor" / "kennfeld.toml", "function") as page:
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


@pytest.mark.guests
@pytest.mark.slow
def test_a_broken_model_is_one_message_and_the_page_stays_open(torque: Path) -> None:
    broken = torque.parent / "engine.slx"
    broken.write_text("not a model")
    with project_page(torque, "function") as page:
        page.select_option("[aria-label='File of the function']", "engine.slx")
        page.wait_for_selector(".import .note.bad")
        assert "is not a Simulink file" in page.inner_text(".import .note.bad")
        page.select_option("[aria-label='File of the function']", "torque.kf")
        page.wait_for_selector("[data-split=error]")


@pytest.mark.guests
@pytest.mark.slow
def test_a_dropped_model_becomes_the_function(torque: Path) -> None:
    with project_page(torque, "function") as page:
        page.set_input_files(".choice input[type=file]", EXAMPLE / "exhaust.mdl")
        page.wait_for_selector("[data-blocking='Sensor/Radiation']")
        assert page.locator("[data-missing]").count() == 5
        page.set_input_files(".state .head input[type=file]", EXAMPLE / "exhaust.m")
        page.wait_for_selector(".chip:has-text('exhaust.m')")
        page.wait_for_selector("[data-missing]", state="detached")


@pytest.mark.guests
@pytest.mark.slow
def test_a_proposed_file_is_taken_by_its_button(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLE, tmp_path / "sensor")
    project = tmp_path / "sensor" / "kennfeld.toml"
    project.write_text(project.read_text("utf-8").replace('parameters = "exhaust.m"\n', ""), "utf-8")
    with project_page(project, "function") as page:
        page.wait_for_selector("[data-missing=TauSensor]")
        page.click("[data-proposal='exhaust.m'] button:text-is('Use exhaust.m')")
        page.wait_for_selector(".chip:has-text('exhaust.m')")
        page.wait_for_selector("[data-missing], [data-proposal]", state="detached")


@pytest.mark.guests
@pytest.mark.slow
def test_a_project_begins_with_a_model(tmp_path: Path) -> None:
    with started(None, tmp_path) as (address, _), browser_page(address) as page:
        page.set_input_files("#drop input", str(EXAMPLE / "exhaust.mdl"))
        page.wait_for_selector(READY)
        page.click("[data-screen=function]")
        page.wait_for_selector("[data-blocking='Sensor/Radiation']")
    assert 'file = "exhaust.mdl"' not in (tmp_path / "exhaust" / "kennfeld.toml").read_text("utf-8")  # not saved yet
    assert (tmp_path / "exhaust" / "exhaust.mdl").is_file()


@pytest.mark.guests
@pytest.mark.slow
def test_a_project_begins_with_the_files_of_an_ascet_application(tmp_path: Path) -> None:
    paths = [tmp_path / "ascet" / Path(name).name for name in BATTERY]
    paths[0].parent.mkdir()
    for path, text in zip(paths, BATTERY.values(), strict=True):
        path.write_text(text)
    libraries = [write_project(tmp_path / "library", {}) / name for name in LIBRARY]
    with started(None, tmp_path) as (address, _), browser_page(address) as page:
        page.set_input_files("#drop input", [str(path) for path in paths])
        page.wait_for_selector("[data-missing]:has-text('Lib.Dynamics, Lib.Math')")
        page.set_input_files("[data-missing] input[type=file]", [str(path) for path in libraries])
        page.wait_for_selector(".ascet .tag.g")
        page.wait_for_selector("[data-missing]", state="detached")
        assert "process Cell.Plant.calc" in page.inner_text("[aria-label='Source text']")
        page.click(".ascet tr:has-text('accu.shift') td:last-child button")
        assert "characteristic CurveOfReal shift[5]" in page.inner_text(".ascet .blocks .lit-line")
        assert page.locator("[aria-label='Source file'] option:checked").inner_text() == "Cell/Accu.esdl"
    assert (tmp_path / "Battery/Cell/Accu.esdl").is_file()


@pytest.mark.guests
@pytest.mark.slow
def test_a_project_begins_with_the_folders_of_an_ascet_project(tmp_path: Path) -> None:
    folder = write_project(tmp_path / "ascet", BATTERY)
    (folder / "Battery/Cell/Plant.bd").write_text("a diagram, which is left out")
    with started(None, tmp_path) as (address, _), browser_page(address) as page:
        devtools = page.context.new_cdp_session(page)
        box = page.locator("#drop").bounding_box()
        data = {"items": [], "files": [str(folder / "Battery"), str(folder / "Lib")], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            place = {"x": box["x"] + 20, "y": box["y"] + 20}
            devtools.send("Input.dispatchDragEvent", {"type": kind, "data": data, **place})
        page.wait_for_selector(".ascet .tag.g")
    assert (tmp_path / "Battery/Lib/Dynamics/Integrator.esdl").is_file()
    assert not list((tmp_path / "Battery").rglob("*.bd"))


@pytest.mark.guests
@pytest.mark.slow
def test_a_class_shows_its_values_at_the_cursor_and_its_errors_at_the_line(tmp_path: Path) -> None:
    folder = write_project(tmp_path, BATTERY)
    (folder / "bench.csv").write_text("T,U,wanted\n0,1.3,5\n30,1.34,9\n60,1.38,14\n")
    (folder / "kennfeld.toml").write_text(
        '[model]\nfile = "Battery/Cell/Accu.esdl"\n[[dataset]]\nfiles = "bench.csv"\n'
        '[[criterion]]\nnode = "charge"\ntarget = "wanted"\n'
    )
    source = folder / "Battery/Cell/Accu.esdl"
    with project_page(folder / "kennfeld.toml", "function") as page:
        value = page.locator(".ascet .blocks .ln:has-text('real charge') .num").last
        value.wait_for()
        page.wait_for_function("node => node.textContent !== ''", arg=value.element_handle())
        assert value.inner_text() == "9.000"
        source.write_text(source.read_text().replace("return max", "return unheard(U) + max"))
        page.click(".ascet button:text-is('Read again')")
        page.click(".ascet .import .note.bad button")
        assert "unheard(U)" in page.inner_text(".ascet .blocks .lit-line.wrong")
        assert page.is_disabled("button:text-is('Edit as formula text')")


@pytest.mark.guests
@pytest.mark.slow
def test_tasks_are_chosen_by_boxes(tmp_path: Path) -> None:
    folder = write_project(tmp_path, BATTERY)
    path = folder / "Battery/Battery.app"
    slow = "task Slow priority 1 period 50ms { process Cell.Sensor.calc }"
    path.write_text(path.read_text().replace("\t\tprocess Cell.Sensor.calc\n\t}\n", f"\t}}\n\t{slow}\n"))
    (folder / "kennfeld.toml").write_text('[model]\nfile = "Battery/Battery.app"\n')
    with project_page(folder / "kennfeld.toml", "function") as page:
        page.wait_for_selector(".import .note.bad:has-text('several tasks')")
        page.click(".ascet button:text-is('All')")
        page.wait_for_selector(".ascet .tag.g")
        assert "every 0.05 s" in page.inner_text(".ascet .import")
        page.click(".ascet .chip:has-text('Task_10ms')")
        page.wait_for_selector(".ascet .head:has-text('step 0.05 s')")
        page.click("#save")
        page.wait_for_selector(READY)
    assert 'task = "Slow"' in (folder / "kennfeld.toml").read_text()


@pytest.mark.slow
def test_a_data_driven_model_is_trained(torque: Path) -> None:
    bench = torque.parent / "bench.csv"
    bench.write_text("".join(bench.read_text().splitlines(keepends=True)[:400]))
    with project_page(torque, "function") as page:
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
        rows = page.locator("[data-surrogate=engine] table tbody tr").all_inner_texts()
        modes = [row.split("\t")[1] for row in rows]
        assert modes == ["static", "static", "plane", "plane", "leave one out", "plane left out"]
