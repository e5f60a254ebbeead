"""`docs/commands.md` states what the help of each command states."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("command_docs", ROOT / "scripts" / "command_docs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date(script):
    stale = [path.name for path, text in script.documents(ROOT / "docs").items() if path.read_text("utf-8") != text]
    assert stale == [], "run: python scripts/command_docs.py docs"


def test_every_command_has_its_section_and_a_line_in_the_table(script):
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for name in script.commands():
        assert f"\n## {name}\n" in text
        assert f"[`{name.removeprefix('kennfeld ')}`](#{name.replace(' ', '-')})" in text


def test_a_command_that_the_page_does_not_mention_gets_a_section(script, tmp_path):
    (tmp_path / "commands.md").write_text("# Commands\n", encoding="utf-8")
    [text] = script.documents(tmp_path).values()
    assert "## kennfeld diff\n\n<!-- options of kennfeld diff -->\n\n```text\nkennfeld diff [OPTIONS] A B\n```" in text
    assert "| `-o DIR`, `--output DIR` | results/ next to the project file | Folder for the results. |" in text
    assert "| `-o FILE`, `--output FILE` | required | Output file. |" in text
    assert "| `--tolerance T` | `0.0` |" in text
    assert "| `[NAME]` | torque | torque, exhaust or idle. |" in text


def test_every_command_has_an_example(script):
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for name in script.commands():
        section = text.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        assert f"```sh\n{name}" in section
