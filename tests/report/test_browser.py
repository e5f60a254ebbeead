"""A report in a browser: effects of pointer, keys, printing and the theme on its figures."""

from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from tests.app.browser import tab
from tests.report.report_projects import a_cube, a_map, a_network, scattered

SIZE = (1300, 900)
IMAGE = "canvas => canvas.toDataURL()"


@pytest.fixture
def show(tmp_path, calibrated):
    """Open the report of a project, given by the function that writes it; errors on the console fail the test."""
    with ExitStack() as stack:

        def show(build: Any, theme: str = "light") -> Any:
            path = tmp_path / "report.html"
            path.write_text(calibrated(build).report, encoding="utf-8")
            page = stack.enter_context(tab(SIZE, theme))
            page.goto(path.as_uri())
            page.wait_for_selector("html[data-ready=yes]")
            return page

        yield show


def canvas_of(page: Any, kind: str) -> Any:
    """Return the first canvas of a kind of figure, in view and drawn."""
    host = page.locator(f"figure.{kind} [data-figure]").first
    host.scroll_into_view_if_needed()
    page.wait_for_function("node => node.dataset.drawn === 'yes'", arg=host.element_handle())
    return host.locator("canvas").first


def changed(page: Any, canvas: Any, before: str) -> None:
    """Wait until a canvas shows another picture."""
    page.wait_for_function("([canvas, before]) => canvas.toDataURL() !== before", arg=[canvas.element_handle(), before])


def lines_of_tooltip(page: Any) -> list[str]:
    return page.locator(".tooltip").evaluate("node => [...node.children].map(child => child.textContent)")


@pytest.mark.slow
def test_a_strip_zooms_by_dragging_and_by_keys_and_a_double_click_shows_the_whole(show):
    page = show(a_map)
    strip = canvas_of(page, "strip")
    whole = strip.evaluate(IMAGE)
    box = strip.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 100, steps=3)
    assert page.locator(".mark").first.is_visible()
    page.mouse.up()
    changed(page, strip, whole)
    zoomed = strip.evaluate(IMAGE)
    strip.press("ArrowRight")
    changed(page, strip, zoomed)
    strip.dblclick()
    page.wait_for_function("([canvas, whole]) => canvas.toDataURL() === whole", arg=[strip.element_handle(), whole])


TIP_IN = 61.3  # s, when a step of 0.2 s begins in a recording of 40 minutes
LONG = """x = { input = "x", count = 5 }
initial = 0
"""


def a_long_drive(shop):
    """A recording with a short step that the first view of its strip cannot show, and a node beside the criterion."""
    time = 0.05 * np.arange(48_000)
    x = 5 + 4 * np.sin(0.01 * time)
    measured = 3 * x + np.where((time > TIP_IN) & (time < TIP_IN + 0.2), 20.0, 0.0)
    columns = {"time [s]": time.round(2), "x": x.round(4), "m": measured.round(4)}
    return shop.project("half = C(x) / 2\ny = 2 * half\n", f"[parameters.C]\n{LONG}", columns)


@pytest.mark.slow
def test_a_part_of_a_long_strip_shows_its_samples(show):
    page = show(a_long_drive)
    strip = canvas_of(page, "strip")
    host = page.locator("figure.strip [data-figure]").first
    assert host.get_attribute("data-shown") == "ranges"
    width = strip.bounding_box()["width"]
    scale = (width - 62 - 12) / 2400  # pixels a second
    begin = round(62 + TIP_IN * scale)
    strip.click(position={"x": begin, "y": 60})
    for _ in range(6):
        page.mouse.wheel(0, -400)
    page.wait_for_selector("figure.strip [data-shown=samples]")
    box = strip.bounding_box()
    values = set()
    for x in range(70, begin + 240, 4):  # the wheel keeps the time below the pointer, to half a pixel of before
        page.mouse.move(box["x"] + x, box["y"] + 60)
        lines = lines_of_tooltip(page)
        values.add(round(float(next(line.split()[1] for line in lines if line.startswith("measured")))))
    assert max(values) - min(values) == 20  # the step, and what is before and behind it
    strip.press("Backspace")
    strip.press("f")
    page.wait_for_selector("figure.strip [data-shown=ranges]")


@pytest.mark.slow
def test_inputs_and_nodes_are_added_below_a_strip_and_removed(show):
    page = show(a_long_drive)
    strip = canvas_of(page, "strip")
    low = strip.bounding_box()["height"]
    choice = page.locator("figure.strip .further select").first
    assert choice.locator("optgroup").evaluate_all("groups => groups.map(group => group.label)") == ["inputs", "nodes"]
    choice.select_option(label="x")
    choice.select_option(label="half")
    host = page.locator("figure.strip [data-figure]").first
    page.wait_for_function("node => node.dataset.signals === 'x,half'", arg=host.element_handle())
    page.wait_for_function("([node, low]) => node.clientHeight > low + 200", arg=[strip.element_handle(), low])
    page.get_by_label("Remove x").click()
    page.wait_for_function("node => node.dataset.signals === 'half'", arg=host.element_handle())


@pytest.mark.slow
def test_every_axis_of_errors_has_two_numbers_or_more(show):
    page = show(a_long_drive)
    canvas_of(page, "strip")
    page.evaluate(
        "() => { window.ticks = []; const own = CanvasRenderingContext2D.prototype.fillText;"
        "CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {"
        " if (x < 62 && this.textAlign === 'right') window.ticks.push([text, y]); own.call(this, text, x, y); } }"
    )
    for _ in range(6):
        page.evaluate("() => { window.ticks = []; }")
        canvas_of(page, "strip").press("ArrowUp")
        page.wait_for_function("() => window.ticks.length > 0")
        lower = [text for text, y in page.evaluate("() => window.ticks") if y > 215]
        assert len(lower) >= 2


def test_the_tooltip_shows_the_values_of_the_data(show):
    page = show(a_map)
    strip = canvas_of(page, "strip")
    box = strip.bounding_box()
    page.mouse.move(box["x"] + 63, box["y"] + 60)  # the first sample is at the left edge
    first = scattered()["m"][0]
    assert lines_of_tooltip(page)[:2] == [
        "sample 0 ",
        f"measured {np.format_float_positional(first, 5, fractional=False)}",
    ]
    assert page.locator(".cross").first.is_visible()
    page.mouse.move(box["x"] + 10, box["y"] - 30)
    assert not page.locator(".tooltip").is_visible()


@pytest.mark.slow
def test_a_name_in_the_legend_hides_and_shows_its_line(show):
    page = show(a_map)
    strip = canvas_of(page, "strip")
    before = strip.evaluate(IMAGE)
    button = page.locator("figure.strip .legend button", has_text="measured").first
    button.press("Enter")
    assert button.get_attribute("aria-pressed") == "false"
    changed(page, strip, before)
    button.press("Enter")
    page.wait_for_function("([canvas, image]) => canvas.toDataURL() === image", arg=[strip.element_handle(), before])


@pytest.mark.slow
def test_a_surface_turns_by_keys_and_names_the_point_under_the_pointer(show):
    page = show(a_map)
    surface = canvas_of(page, "parameter")
    before = surface.evaluate(IMAGE)
    surface.press("ArrowLeft")
    changed(page, surface, before)
    box = surface.bounding_box()
    for y in range(20, int(box["height"]), 12):
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + y)
        if page.locator(".tooltip").is_visible():
            break
    text = lines_of_tooltip(page)
    assert text[0].startswith("x ")
    assert text[1].startswith("z ")
    assert text[2].startswith("after ")


def test_the_table_of_a_parameter_shows_the_values_of_the_result(show):
    page = show(a_map)
    canvas_of(page, "parameter")
    figure = page.evaluate("JSON.parse(document.getElementById('report-data').textContent).figures.at(-2)")
    assert figure["kind"] == "parameter"

    def cells() -> list[float]:
        texts = page.locator("table.grid td").all_text_contents()
        return [float(text.replace("\u2212", "-")) for text in texts]

    after = np.reshape(figure["after"], (5, 4)).T.ravel()  # x runs across
    np.testing.assert_allclose(cells(), after, atol=0.006)
    page.locator(".choice button", has_text="training samples").click()
    assert cells() == np.reshape(figure["samples"], (5, 4)).T.ravel().tolist()
    page.locator(".choice button", has_text="before").click()
    assert set(cells()) == {1.0}


@pytest.mark.slow
@pytest.mark.guests
def test_weights_are_drawn_as_cells_and_listed_by_rows(show):
    pytest.importorskip("onnx", reason="the package onnx is not installed")
    page = show(a_network)
    cells = canvas_of(page, "parameter")
    assert page.locator("figure.parameter canvas").count() == 2  # before and after
    box = cells.bounding_box()
    page.mouse.move(box["x"] + 40, box["y"] + 10)
    assert [line.strip() for line in lines_of_tooltip(page)[:2]] == ["row 0", "column 0"]
    figure = page.evaluate("JSON.parse(document.getElementById('report-data').textContent).figures.at(-2)")
    page.locator("figure.parameter details summary").click()
    texts = page.locator("table.grid td").all_text_contents()
    numbers = [text.replace("\u2212", "-") for text in texts]
    half = [0.501 * 10.0 ** -len(number.partition(".")[2]) for number in numbers]  # of the last digit shown
    assert (np.abs(np.array(numbers, float) - figure["after"]) <= half).all()
    assert len(set(numbers)) > 1


@pytest.mark.slow
def test_a_slider_chooses_the_slice_of_a_cube(show):
    page = show(a_cube)
    surface = canvas_of(page, "parameter")
    before, numbers = surface.evaluate(IMAGE), page.locator("table.grid td").all_text_contents()
    page.locator(".slider input").press("ArrowRight")
    changed(page, surface, before)
    assert page.locator(".slider output").text_content() == "w = 10"
    assert page.locator("table.grid td").all_text_contents() != numbers


@pytest.mark.slow
def test_a_report_follows_the_theme_and_prints_everything_on_white(show):
    page = show(a_map, "dark")
    ground = "getComputedStyle(document.body).backgroundColor"
    assert page.evaluate(ground) == "rgb(16, 19, 23)"
    strip = canvas_of(page, "strip")
    dark = strip.evaluate(IMAGE)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    assert page.locator("[data-figure]:not([data-drawn])").count() == 0
    assert page.locator("details:not([open])").count() == 0
    assert strip.evaluate(IMAGE) != dark
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    assert strip.evaluate(IMAGE) == dark
    assert page.locator("details:not([open])").count() > 0
    page.emulate_media(color_scheme="light")
    page.wait_for_selector("html[data-theme=light]")
    assert page.evaluate(ground) == "rgb(246, 247, 249)"
