"""The plots and the overlays of a table in a headless browser."""

import json
from pathlib import Path
from typing import Any

import pytest

from kennfeld.app.session.session import Session
from tests.app.browser import READY
from tests.app.shared_app import project_page

STRIPS = ".stack > .canvas"


def drag(page: Any, selector: str, begin: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag between two places of an element, given as shares of its size."""
    box = page.locator(selector).bounding_box()
    points = [(box["x"] + box["width"] * x, box["y"] + box["height"] * y) for x, y in (begin, end)]
    page.mouse.move(*points[0])
    page.mouse.down()
    page.mouse.move((points[0][0] + points[1][0]) / 2, (points[0][1] + points[1][1]) / 2)
    page.mouse.move(*points[1])
    page.mouse.up()


def titles(page: Any) -> list[str]:
    return page.locator("[data-strip] .nm b").all_inner_texts()


def test_a_signal_is_searched_and_added_and_kept_for_the_project(exhaust: Path) -> None:
    with project_page(exhaust) as page:
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='4']")
        before = titles(page)
        assert before == ["TemperaturePredict", "Error", "Speed", "Injection", "AirMass"]
        page.keyboard.press("s")
        page.wait_for_selector("#signal-search:focus")
        page.keyboard.type("settl")
        page.wait_for_selector("[data-signal='node:settled'][aria-selected=true]")
        page.keyboard.press("Enter")
        page.wait_for_selector("[data-strip='5']")
        assert titles(page) == ["TemperaturePredict", "settled", *before[1:]]
        page.fill("#signal-search", "airmass")
        page.wait_for_selector("[data-signal='channel:AirMass'][aria-selected=true]")
        page.keyboard.press("Shift+Enter")
        page.wait_for_selector("[data-strip='1'] .v:has-text('AirMass')")
        page.keyboard.press("Escape")
        page.wait_for_selector("#signal-search", state="detached")
        page.focus("[data-strip='1']")
        page.keyboard.press("Alt+ArrowDown")
        page.wait_for_selector("[data-strip='2']:has-text('settled')")
        page.keyboard.press("Delete")
        page.wait_for_selector("[data-strip='5']", state="detached")
        assert titles(page) == before
        page.focus("[data-strip='4']")
        page.keyboard.press("Delete")
        page.wait_for_selector("[data-strip='4']", state="detached")
        page.reload()
        page.wait_for_selector(READY)
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='3']")
        assert titles(page) == before[:4]


@pytest.mark.slow
def test_a_removed_signal_does_not_hide_the_others(exhaust: Path) -> None:
    strips = [{"weight": 1, "lines": [{"kind": "channel", "name": name}]} for name in ("Gone", "Speed")]
    with project_page(exhaust) as page:
        script = "([key, value]) => localStorage.setItem(key, value)"
        page.evaluate(script, [f"kennfeld.plots:{exhaust}", json.dumps({"strips": strips})])
        page.reload()
        page.wait_for_selector(READY)
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='0']:has-text('not in this dataset')")
        box = page.locator(STRIPS).bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.75)
        page.wait_for_function(
            "() => Number(document.querySelector(`[data-strip='1'] .v .hv`).innerText.slice(2)) > 500"
        )


@pytest.mark.slow
def test_strips_are_moved_and_resized_by_the_mouse(exhaust: Path) -> None:
    with project_page(exhaust) as page:
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='4']")
        page.drag_and_drop("[data-strip='4'] .nm b", "[data-strip='0'] .nm b")
        page.wait_for_selector("[data-strip='0']:has-text('AirMass')")
        page.keyboard.press("s")
        page.drag_and_drop("[data-signal='node:settled']", STRIPS, target_position={"x": 200, "y": 20})
        page.wait_for_selector("[data-strip='0'] .v:has-text('settled')")
        high = page.locator("[data-strip='1']").bounding_box()["height"]
        drag(page, "[data-strip='1'] .grip", (0.5, 0.5), (0.5, 8))
        page.wait_for_selector(READY)
        assert page.locator("[data-strip='1']").bounding_box()["height"] > high + 20


@pytest.mark.slow
def test_keys_zoom_and_move_the_cursor_sample_by_sample(exhaust: Path) -> None:
    recording = Session(exhaust).require_view().model.recordings[0]
    speed = recording.channel("Speed")
    with project_page(exhaust) as page:
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='4']")
        whole = page.inner_text(".tool .span")
        drag(page, STRIPS, (0.3, 0.3), (0.6, 0.3))
        page.wait_for_selector(".tool .of")
        zoomed = page.inner_text(".tool .span")
        page.keyboard.press("w")
        page.wait_for_selector(".tool .of", state="detached")
        assert page.inner_text(".tool .span") == whole
        page.keyboard.press("Backspace")
        page.wait_for_selector(".tool .of")
        assert page.inner_text(".tool .span") == zoomed
        condition = "value => Math.abs(Number(document.querySelector(`[data-strip='2'] .v b`).innerText) - value) < 0.6"
        page.keyboard.press("Home")
        page.wait_for_function(condition, arg=float(speed[0]))
        for key, sample in (("ArrowRight", 1), ("Shift+ArrowRight", 11), ("ArrowLeft", 10), ("End", -1)):
            page.keyboard.press(key)
            page.wait_for_function(condition, arg=float(speed[sample]))


@pytest.mark.slow
def test_a_range_shows_its_length_and_the_statistics_of_each_signal(exhaust: Path) -> None:
    with project_page(exhaust) as page:
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='4']")
        page.keyboard.press("r")
        drag(page, STRIPS, (0.3, 0.3), (0.6, 0.3))
        page.wait_for_selector(".rg tbody tr:nth-child(7)")
        begin, end = (float(part) for part in page.inner_text(".tool .span").split(" s")[0].split(" … "))
        plot = page.locator(STRIPS).bounding_box()["width"] - 56
        share = 0.3 * page.locator(STRIPS).bounding_box()["width"] / plot
        assert float(page.inner_text("#range-length")) == pytest.approx(share * (end - begin), rel=0.02)
        row = page.locator(".rg tr:has-text('Speed') td").all_inner_texts()
        least, mean, greatest, rms = (float(text) for text in row[2:])
        assert least < mean < rms < greatest


@pytest.mark.slow
def test_a_rectangle_in_a_scatter_becomes_a_condition_a_weight_and_a_view(exhaust: Path) -> None:
    with project_page(exhaust) as page:
        page.click("[data-screen=plots]")
        page.click("text=x, y")
        page.select_option("[aria-label='Signal upwards']", "channel:Injection")
        page.wait_for_selector(".sc canvas")
        page.wait_for_selector(READY)
        drag(page, ".sc .canvas", (0.4, 0.3), (0.6, 0.6))
        page.wait_for_selector("[data-brushed]:not([data-brushed='0'])")
        page.wait_for_selector(READY)
        brushed = int(page.get_attribute("[data-brushed]", "data-brushed"))
        assert 100 < brushed < 20_000
        page.click("text=Only these")
        page.wait_for_selector("#only")
        before = page.inner_text("#rmse-training")
        page.click("text=As where")
        page.wait_for_function("before => document.querySelector('#rmse-training').innerText !== before", arg=before)
        page.click("text=Weight…")
        page.fill("[aria-label='Weight of the brushed samples']", "2,5")
        page.keyboard.press("Enter")
        page.wait_for_selector("footer:has-text('weight 2,5')")
        page.click("#save")
        page.wait_for_selector("#unsaved:not(.dirty)")
    [where] = [line for line in exhaust.read_text(encoding="utf-8").splitlines() if line.startswith("where")]
    assert where.startswith('where = "Speed >= ')
    assert "Injection <= " in where
    view = Session(exhaust).require_view()
    assert view.model.problem.criteria[0].regions[0].weight == 2.5
    assert view.start.scores[0].samples <= brushed


@pytest.mark.slow
def test_a_stretch_without_time_stamps_names_the_reason_against_a_condition(torque: Path) -> None:
    with project_page(torque) as page:
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='0']")
        page.keyboard.press("b")
        drag(page, STRIPS, (0.3, 0.2), (0.6, 0.2))
        page.wait_for_selector(".foot .reason:has-text('no time stamps')")
        assert page.locator("text=As where").count() == 0


@pytest.mark.slow
def test_a_clicked_sample_shows_its_error_and_corrections(torque: Path) -> None:
    with project_page(torque) as page:
        page.click("[data-screen=plots]")
        page.wait_for_selector("[data-strip='0']")
        page.wait_for_selector(READY)
        box = page.locator(STRIPS).bounding_box()
        page.mouse.click(box["x"] + box["width"] * 0.4, box["y"] + 40)
        page.wait_for_selector("[data-split=corrections]")
        error, legend = page.inner_text("[data-split=error]"), page.inner_text("[data-strip='1'] .v b")
        assert float(error.replace("−", "-")) == pytest.approx(float(legend.replace("−", "-")), rel=0.2, abs=20)
        page.select_option("#criterion", "1")
        page.wait_for_selector(".sample dt:has-text('dragTorque')")


@pytest.mark.slow
def test_a_grid_point_highlights_its_samples_in_the_plots(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    with project_page(exhaust) as page:
        page.click("[data-cell='6,4']")
        page.wait_for_selector("text=Show in Plots")
        page.wait_for_selector(READY)
        page.click("text=Show in Plots")
        page.wait_for_selector("[data-brushed]")
        [part] = [each for each in view.evidence.informing("MapSettled", 6 * 12 + 4) if each.dataset == 0]
        assert page.get_attribute("[data-brushed]", "data-brushed") == str(part.samples.size)


@pytest.mark.slow
def test_overlays_colour_the_cells_by_samples_and_mean_error(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    counts = view.samples["MapSettled"]
    with project_page(exhaust) as page:
        page.click("[data-parameter=MapSettled]")
        page.click("button.chip:has-text('samples')")
        page.wait_for_selector("[data-cell='6,4'] .cv")
        few = next((i, j) for i in range(12) for j in range(12) if 0 < counts[i, j] < 1000)
        assert page.get_attribute(f"[data-cell='{few[0]},{few[1]}'] .cv", "data-note") == str(counts[few])
        text = page.inner_text("[data-cell='6,4']")
        page.click("button.chip:has-text('mean error')")
        page.click("button.chip:has-text('points')")
        note = "document.querySelector(`[data-cell='6,4'] .cv`)?.dataset.note ?? ''"
        page.wait_for_function(f"() => /^[+−]/.test({note})")
        assert page.inner_text("[data-cell='6,4']") == text
        mean = view.evidence.mean_errors("MapSettled", [errors[0] for errors in view.now.errors])[6, 4]
        assert float(page.evaluate(note).replace("−", "-")) == pytest.approx(mean, abs=1.0)
