"""Settings in a headless browser: every key has a field that finds it, explains it, sets it and resets it."""

from pathlib import Path
from typing import Any

import pytest

from kennfeld.project import Project
from kennfeld.project.key_descriptions import describe_sections
from tests.app.browser import READY
from tests.app.shared_app import project_page


def jump(page: Any, key: str) -> None:
    """Go to a key with the command palette."""
    page.keyboard.press("Control+k")
    page.keyboard.type(key)
    page.keyboard.press("Enter")
    page.wait_for_selector(f"[data-setting='{key}']:focus-within")


def enter(page: Any, label: str, text: str) -> None:
    page.fill(f"[aria-label='{label}']", text)
    page.keyboard.press("Enter")


# For each key: open the palette, enter the key, press Enter, and return the help beside the field that has the focus,
# null if no field of the key gets it. All in the page: keys pressed from outside take half a second for each key.
JUMPS = """
async keys => {
  const press = (target, key, ctrlKey) =>
    target.dispatchEvent(new KeyboardEvent("keydown", { key, ctrlKey, bubbles: true, cancelable: true }));
  const wait = async condition => {
    for (const end = Date.now() + 5000; !condition() && Date.now() < end; ) await new Promise(done => setTimeout(done));
  };
  const helps = {};
  for (const key of keys) {
    document.activeElement.blur();
    press(document.body, "k", true);
    await wait(() => document.activeElement.matches("input"));
    const field = document.activeElement;
    field.value = key;
    field.dispatchEvent(new InputEvent("input", { bubbles: true }));
    await new Promise(done => setTimeout(done));
    press(field, "Enter", false);
    const row = () => document.querySelector(`[data-setting='${key}']:focus-within`);
    await wait(row);
    helps[key] = row() && (row().querySelector(".help")?.innerText ?? "");
  }
  return helps;
}
"""


def keys_with_help() -> dict[str, str]:
    """Return the help of every key."""
    helps = {}
    for section in describe_sections():
        keys = section["form"].get("keys", ())
        if section["name"] == "axes":
            continue  # the project has no group axes, see below
        if section["name"] == "parameters":
            keys = [key for key in keys if key["name"] not in ("z", "w")]  # the open table is a map
        helps |= {f"{section['name']}.{key['name']}": key["help"] for key in keys}
    return helps


@pytest.mark.slow
def test_the_palette_finds_the_field_of_every_key(torque: Path) -> None:
    before, expected = torque.read_bytes(), keys_with_help()
    with project_page(torque) as page:
        page.set_viewport_size({"width": 480, "height": 320})  # quickly drawn
        helps = page.evaluate(JUMPS, list(expected))
        wrong = [name for name, text in helps.items() if text is None or (text and expected[name] not in text)]
        assert wrong == []
        assert page.is_disabled("#save")
    assert torque.read_bytes() == before


def test_a_value_set_and_reset_in_the_page_leaves_the_file_byte_for_byte(torque: Path) -> None:
    before = torque.read_bytes()
    with project_page(torque) as page:
        jump(page, "optimizer.spread")
        page.keyboard.type("0,25")
        page.keyboard.press("Enter")
        page.wait_for_selector("#unsaved.dirty")
        page.click("#save")
        page.wait_for_selector("#save[disabled]")
        assert b"spread = 0.25" in torque.read_bytes()
        page.click("[aria-label='Remove optimizer.spread, back to the default']")
        page.wait_for_selector("#unsaved.dirty")
        jump(page, "parameters.smoothness")
        enter(page, "parameters.smoothness", "5")
        page.wait_for_selector(".mono:has-text('smoothness = 5')")
        page.keyboard.press("Control+z")  # nothing is typed: the last command, not the text of the field
        page.wait_for_selector(".mono:has-text('smoothness = 100')")
        page.click("#save")
        page.wait_for_selector("#save[disabled]")
    assert torque.read_bytes() == before


@pytest.mark.slow
def test_a_comment_has_paragraphs(torque: Path) -> None:
    with project_page(torque) as page:
        jump(page, "report.comment")
        page.keyboard.type("Bench 3.")
        page.keyboard.press("Enter")
        page.keyboard.press("Enter")
        page.keyboard.type("Second paragraph.")
        page.keyboard.press("Control+Enter")
        page.wait_for_selector("#unsaved.dirty")
        page.click("#save")
        page.wait_for_selector("#save[disabled]")
        assert page.input_value("textarea[aria-label='report.comment']") == "Bench 3.\n\nSecond paragraph."
    assert b'comment = "Bench 3.\\n\\nSecond paragraph."' in torque.read_bytes()


@pytest.mark.slow
def test_a_message_stands_at_its_field(torque: Path) -> None:
    with project_page(torque) as page:
        jump(page, "dataset.where")
        page.keyboard.type("Sped > 1000")
        page.keyboard.press("Enter")
        remark = page.wait_for_selector("[data-entry='1'] + .settings > .remark.bad")
        assert remark.inner_text() == "has no channel Sped, the condition `where`. Did you mean Speed?"
        enter(page, "dataset.where", "Speed >")
        remark = page.wait_for_selector("[data-setting='dataset.where'] .remark.bad")
        assert "kennfeld.toml" not in remark.inner_text()
        page.click("[aria-label='Remove dataset.where, back to the default']")
        page.wait_for_selector("[data-setting='dataset.where'] .remark", state="detached")


@pytest.mark.slow
def test_a_criterion_is_added_selected_and_removed(torque: Path) -> None:
    before = torque.read_text(encoding="utf-8")
    with project_page(torque) as page:
        first = page.inner_text("#rmse-training")
        page.click("[data-screen=optimization]")
        page.click("[data-add=criterion]")
        enter(page, "criterion.node", "trqOpt")
        assert page.is_disabled("#save")  # it has no target yet
        enter(page, "criterion.target channel", "Torque")
        page.wait_for_selector("[data-section=criterion] [data-entry='3']")
        page.click("#more-errors")
        page.click("[data-criterion=trqOpt] button")
        page.wait_for_selector(".errs .nm:has-text('trqOpt')")
        page.click("[aria-label='Remove criterion 3']")
        page.wait_for_selector("[data-entry='3']", state="detached")
        page.wait_for_function("first => document.querySelector('#rmse-training').innerText === first", arg=first)
        page.wait_for_selector("#save[disabled]")  # what is removed again leaves nothing to save
    assert torque.read_text(encoding="utf-8") == before


@pytest.mark.slow
def test_shared_axes_locks_and_pins_of_a_table(torque: Path) -> None:
    with project_page(torque) as page:
        jump(page, "parameters.lock")
        page.select_option("[aria-label='Kind of parameters.lock']", "ranges")
        page.click("[aria-label='Add to parameters.lock']")
        enter(page, "parameters.lock 1 x, lower", "700")
        page.wait_for_selector("[data-setting='parameters.lock'].set")
        enter(page, "parameters.lock 1 x, upper", "1000")
        page.wait_for_selector("td.lock")
        jump(page, "parameters.pin")
        page.click("[aria-label='Add to parameters.pin']")
        enter(page, "parameters.pin 1 value", "90")
        enter(page, "parameters.pin 1 at", "2200 64")
        page.wait_for_selector(".prop:has-text('Pinned')")
        page.click(".settings-panel >> text=Shared axes")
        enter(page, "Name of a new axis", "AxisSpeed")
        page.wait_for_selector("[data-section=axes] [data-entry=AxisSpeed]")
        enter(page, "axes.input", "Speed")
        enter(page, "axes.breakpoints", "700; 2000,5; 6000")
        page.wait_for_selector("[data-setting='axes.breakpoints'].set")
        page.wait_for_selector(READY)
        page.click("#save")
        page.wait_for_selector("#save[disabled]")
    text = torque.read_text(encoding="utf-8")
    assert "lock = [{ x = [700, 1000] }]" in text
    assert "pin = [{ value = 90, at = [2200, 64] }]" in text
    assert "breakpoints = [700, 2000.5, 6000]" in text


@pytest.mark.slow
def test_a_line_of_toml_shows_the_message_of_the_schema(torque: Path) -> None:
    with project_page(torque) as page:
        jump(page, "parameters.bounds")
        page.select_option("[aria-label='Kind of parameters.bounds']", "by value")
        enter(page, "parameters.bounds, as TOML", "[0, 'high']")
        page.wait_for_selector(
            "[data-setting='parameters.bounds'] [role=alert]:has-text('upper bound: must be a number')"
        )
        assert page.is_disabled("#save")
        enter(page, "parameters.bounds, as TOML", "[0, 500]")
        page.wait_for_selector("#unsaved.dirty")
        page.wait_for_selector("[data-setting='parameters.bounds'] [role=alert]", state="detached")


@pytest.mark.slow
def test_steps_are_moved_and_unknown_keys_removed(torque: Path) -> None:
    text = torque.read_text(encoding="utf-8")
    torque.write_text(
        text + '\n[[step]]\nname = "fine"\ncolour = 3\n\n[[step]]\nname = "coarse"\ngrid_reduction = 2\n',
        encoding="utf-8",
    )
    with project_page(torque) as page:
        page.click("[data-screen=optimization]")
        page.click("[data-section=step] [data-entry='1'] .fold")
        page.wait_for_selector("[data-setting='step.colour'] .remark:has-text('unknown key')")
        page.click("[aria-label='Remove step.colour, back to the default']")
        page.wait_for_selector("[data-setting='step.colour']", state="detached")
        page.click("[aria-label='Move step 2 up']")
        page.wait_for_selector("[data-section=step] [data-entry='1']:has-text('coarse')")
        page.click("#save")
        page.wait_for_selector("#save[disabled]")
    assert (
        torque.read_text(encoding="utf-8")
        == text + '\n[[step]]\nname = "coarse"\ngrid_reduction = 2\n\n[[step]]\nname = "fine"\n'
    )


def test_a_new_limit_keeps_its_bounds_in_view_and_the_cursor(torque: Path) -> None:
    with project_page(torque, "optimization") as page:
        page.click("[data-add=limit]")
        page.fill("[data-setting='limit.node'] input", "TorquePredict")
        page.keyboard.press("Enter")
        page.fill("[data-setting='limit.min'] input", "-50")
        page.keyboard.press("Tab")
        page.wait_for_selector("[data-section=limit] [data-entry='1']")
        page.wait_for_selector("[data-section=limit] .draft", state="detached")
        assert page.is_visible("[data-setting='limit.min']")
        page.wait_for_selector("[data-setting='limit.max']:focus-within")
        page.keyboard.type("400")
        page.keyboard.press("Enter")
        page.wait_for_function("() => document.getElementById('unsaved').innerText.startsWith('2 unsaved')")
        page.click("#save")
        page.wait_for_selector("#save[disabled]")
    assert '[[limit]]\nnode = "TorquePredict"\nmin = -50\nmax = 400\n' in torque.read_text(encoding="utf-8")


# all of it before a frame is painted and before an answer comes: only what runs at once can be seen
AT_ONCE = """
async steps => {
  const turn = async () => { for (let k = 0; k < 20; k++) await Promise.resolve(); };
  const press = (key, ctrlKey) => document.activeElement.dispatchEvent(
    new KeyboardEvent("keydown", { key, ctrlKey, bubbles: true, cancelable: true }));
  for (const step of steps) {
    if (step.focus) document.querySelector(step.focus).focus();
    if (step.text !== undefined) {
      document.activeElement.value = step.text;
      document.activeElement.dispatchEvent(new InputEvent("input", { bubbles: true }));
    }
    await turn();
    if (step.key) press(step.key, step.control ?? false);
    await turn();
  }
  return document.activeElement.closest("[data-setting]")?.dataset.setting ?? "";
}
"""


def test_keys_that_follow_each_other_at_once_find_what_those_before_did(torque: Path) -> None:
    with project_page(torque) as page:
        page.click("[data-screen=parameters]")
        page.click("[data-parameter=MapOptTorque]")
        page.wait_for_selector(READY)
        # the cursor is in the field when the palette closes
        palette = [{"focus": "body", "key": "k", "control": True}, {"text": "parameters.bounds", "key": "Enter"}]
        assert page.evaluate(AT_ONCE, palette) == "parameters.bounds"
        lower, upper = (
            f"[data-setting='parameters.bounds'] input[aria-label$='{side}']" for side in ("lower", "upper")
        )
        # the second bound keeps the first one, and a save has what was typed and not entered
        page.evaluate(
            AT_ONCE,
            [
                {"focus": lower, "text": "-50"},
                {"focus": upper, "text": "900", "key": "Enter"},
                {"text": "950", "key": "s", "control": True},
            ],
        )
        page.wait_for_selector(READY)
        page.wait_for_selector("#save:disabled")
    assert Project.read(torque).file.parameters["MapOptTorque"].bounds == (-50, 950)
