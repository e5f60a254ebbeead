"""The editor of a map in a browser: table, value field, surface and slices show and change the same values."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kennfeld.project import Project
from tests.app.browser import READY
from tests.app.shared_app import project_page

# the middle of the dot: the pixels of its colour that lie in the midst of such
DOT = """
canvas => {
  const { width, height } = canvas;
  const data = canvas.getContext('2d').getImageData(0, 0, width, height).data;
  const green = (x, y) => [35, 131, 74].every((part, k) => data[4 * (y * width + x) + k] === part);
  const inside = [];
  for (let y = 3; y < height - 3; y++) {
    for (let x = 3; x < width - 3; x++) {
      if ([[0, 0], [-2, 0], [2, 0], [0, -2], [0, 2]].every(([a, b]) => green(x + a, y + b))) inside.push([x, y]);
    }
  }
  const mean = k => inside.reduce((sum, each) => sum + each[k], 0) / inside.length;
  return [mean(0) / devicePixelRatio, mean(1) / devicePixelRatio];
}
"""
# the number of pixels in the colour of linked evidence
LIT = """
canvas => {
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let k = 0; k < data.length; k += 4) count += [217, 119, 6].every((part, i) => data[k + i] === part);
  return count;
}
"""
# the cells that change while a key is handled and answered
CHANGED_CELLS = """
() => {
  window.changed = new Set();
  const observer = new MutationObserver(records => {
    for (const { target } of records) {
      const element = target instanceof Element ? target : target.parentElement;
      const cell = element.closest('td[data-cell]');
      if (cell) window.changed.add(cell.dataset.cell);
    }
  });
  const every = { subtree: true, childList: true, attributes: true, characterData: true };
  observer.observe(document.querySelector('table.grid'), every);
}
"""


@pytest.fixture
def editor(exhaust: Path) -> Iterator[Any]:
    """Open MapSettled of the exhaust demo."""
    with project_page(exhaust) as page:
        page.click("[data-screen=parameters]")
        page.click("[data-parameter=MapSettled]")
        page.wait_for_selector("[data-cell='11,11']")
        yield page


def number(text: str) -> float:
    return float(text.replace("\u2212", "-"))


def cell(page: Any, i: int, j: int) -> float:
    return number(page.inner_text(f"[data-cell='{i},{j}']"))


def drag_dot(page: Any, canvas: str, up: int) -> None:
    """Drag the dot of a picture upwards."""
    element = page.locator(canvas).first
    box = element.bounding_box()
    x, y = element.evaluate(DOT)
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.mouse.down()
    page.mouse.move(box["x"] + x, box["y"] + y - up, steps=3)
    page.mouse.up()
    page.wait_for_selector(READY)


@pytest.mark.slow
def test_the_value_field_sets_all_selected_values(editor: Any) -> None:
    editor.click("[data-cell='2,3']")
    editor.click("[data-cell='3,4']", modifiers=["Shift"])
    field = editor.locator(".selbar input")
    field.fill("512,5")
    field.press("Enter")
    for i, j in ((2, 3), (2, 4), (3, 3), (3, 4)):
        editor.wait_for_selector(f"[data-cell='{i},{j}']:has-text('512.5')")
    assert editor.inner_text(".readout b") == "512.5 degC"
    field.fill("*2")
    field.press("Enter")
    editor.wait_for_selector("[data-cell='2,3']:has-text('1025')")
    editor.click("#undo")
    editor.wait_for_selector("[data-cell='2,3']:has-text('512.5')")
    assert field.input_value() == "512.5"
    field.fill("high")
    field.press("Enter")
    assert field.input_value() == "512.5"


@pytest.mark.parametrize(
    "canvas",
    [pytest.param(".surf canvas", id="surface"), pytest.param(".slic canvas", id="slice", marks=pytest.mark.slow)],
)
def test_a_dragged_dot_changes_the_active_value_alone(editor: Any, canvas: str) -> None:
    editor.click("[data-cell='5,6']")
    before = cell(editor, 5, 6)
    drag_dot(editor, canvas, 20)
    after = cell(editor, 5, 6)
    assert after > before
    assert number(editor.inner_text(".readout b").split()[0]) == pytest.approx(after, abs=0.06)
    assert cell(editor, 5, 5) == before  # the start is flat
    assert cell(editor, 4, 6) == before
    editor.click("#undo")  # one drag is one step
    editor.wait_for_function(
        "number => document.querySelector('[data-cell=\"5,6\"]').innerText === number", arg=f"{before:g}"
    )


@pytest.mark.slow
def test_an_edit_redraws_the_cells_that_look_different_and_no_other(editor: Any) -> None:
    for at, value in (("0,0", "900.5"), ("11,11", "100.5")):  # the range of the colours, and the decimals
        editor.click(f"[data-cell='{at}']")
        editor.keyboard.type(value)
        editor.keyboard.press("Enter")
    editor.click("[data-cell='5,6']")
    editor.wait_for_selector(READY)
    editor.evaluate(CHANGED_CELLS)
    editor.keyboard.press("+")
    editor.wait_for_function("() => window.changed.size > 0")
    editor.wait_for_selector(READY)
    assert editor.evaluate("[...window.changed]") == ["5,6"]


@pytest.mark.slow
def test_samples_that_inform_a_point_are_shown_for_a_curve_too(editor: Any, exhaust: Path) -> None:
    points = Project.read(exhaust).problem().parameters["CurveTimeConstant"].axes[0].breakpoints
    editor.click("[data-parameter=CurveTimeConstant]")
    editor.wait_for_selector(f"[data-cell='{len(points) - 1},0']")
    editor.click("[data-cell='3,0']")
    editor.wait_for_selector(f".evid dd:has-text('{points[3]:g}')")
    editor.wait_for_selector(".timeline canvas")
    samples = number(editor.inner_text(".evid dd:has-text('stretches')").split()[0].replace("\u2009", ""))
    assert samples > 0
    assert editor.locator(".evid .n1 canvas").evaluate(LIT) > 20


def test_marks_reference_and_order_follow_the_keys_and_choices(editor: Any) -> None:
    grid, cell = editor.locator("table.grid"), "td[data-cell='3,2']"
    editor.click(cell)
    grid.press("l")
    editor.wait_for_selector(f"{cell}.lock")
    editor.wait_for_selector(READY)
    assert editor.locator("button:text-is('Fit this point only')").is_disabled()
    grid.press("l")
    editor.wait_for_selector(f"{cell}:not(.lock)")
    editor.wait_for_selector(READY)
    grid.press("p")
    editor.wait_for_selector(f"{cell}.pinned")
    editor.wait_for_selector(READY)
    grid.press("Shift+ArrowRight")
    grid.press("p")  # both, as one of them is not pinned yet
    editor.wait_for_selector("td[data-cell='4,2'].pinned")
    editor.wait_for_selector(READY)
    grid.press("p")
    editor.wait_for_selector(f"{cell}:not(.pinned)")
    editor.wait_for_selector(READY)
    grid.press("d")
    assert editor.locator("button:text-is('Difference')").get_attribute("aria-pressed") == "true"
    grid.press("d")
    editor.select_option("select[aria-label='Compare with']", "start")
    editor.wait_for_selector(READY)
    assert "start, difference" in editor.inner_text(".facts3")
    names = lambda: editor.locator("[data-parameter] b").all_inner_texts()  # noqa: E731
    assert names() == ["MapSettled", "CurveTimeConstant"]
    editor.click("[data-parameter=CurveTimeConstant]")
    editor.wait_for_selector(READY)
    grid.focus()
    grid.press("*")
    grid.press("2")
    grid.press("Enter")
    editor.wait_for_selector(READY)
    editor.select_option("select[aria-label='Sort the parameters']", "change")
    editor.wait_for_function("() => document.querySelector('[data-parameter] b').textContent === 'CurveTimeConstant'")


@pytest.mark.slow
def test_a_selection_is_fitted_alone_as_a_run_of_the_history(editor: Any) -> None:
    editor.click("td[data-cell='3,2']")
    editor.locator("table.grid").press("Shift+ArrowRight")
    before = editor.locator("table.grid td").all_inner_texts()
    editor.click(".selbar button:text-is('Fit')")
    editor.wait_for_selector("header .job:has-text('converged')", timeout=60_000)
    editor.wait_for_selector(READY)
    after = editor.locator("table.grid td").all_inner_texts()
    width = editor.locator("table.grid tr").first.locator("th").count() - 1
    changed = {k for k, (one, two) in enumerate(zip(before, after, strict=True)) if number(one) != number(two)}
    assert changed == {2 * width + 3, 2 * width + 4}
    editor.click("[data-screen=results]")
    editor.wait_for_selector("[data-set='1']:has-text('2 × 1 points only')")


# moves the mouse over a picture until a box with values appears; returns its lines
HOVER = """
async canvas => {
  const { left, top } = canvas.getBoundingClientRect();
  for (let y = 4; y < canvas.clientHeight; y += 8) {
    for (let x = 4; x < canvas.clientWidth; x += 8) {
      canvas.dispatchEvent(new PointerEvent("pointermove", { clientX: left + x, clientY: top + y }));
      for (let k = 0; k < 20; k++) await Promise.resolve();
      const tip = document.querySelector(".tip.under");
      if (tip) return [...tip.children].map(line => line.textContent);
    }
  }
  return [];
}
"""


def test_pictures_show_the_values_under_the_mouse(editor: Any) -> None:
    for label in ("Surface of MapSettled, now and reference", "Slice of MapSettled over Speed"):
        canvas = editor.locator(f"[aria-label='{label}'] canvas").first
        value, *_, place = canvas.evaluate(HOVER)
        along, across = re.fullmatch(r"\S+ (\S+) \S+, \S+ (\S+) \S+", place).groups()  # type: ignore[union-attr]
        i, j = (
            editor.locator(f"table.grid {line}").all_inner_texts().index(text) - 1
            for line, text in (("tr:first-child th", along), ("tr th:first-child", across))
        )
        assert number(value.split()[0]) == pytest.approx(cell(editor, i, j), abs=0.6)
        canvas.dispatch_event("pointerleave")
        editor.wait_for_selector(".tip.under", state="detached")
