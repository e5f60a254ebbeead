"""The tables of formats in README and `docs/formats.md` state what the records of the formats state."""

from pathlib import Path

import format_docs
import pytest

from kennfeld.files.formats import calibration_formats, formats_of, recording_formats

DOCS = Path(__file__).parents[2] / "docs"


def test_the_tables_are_up_to_date():
    stale = [path.name for path, text in format_docs.documents(DOCS).items() if path.read_text("utf-8") != text]
    assert stale == [], "run: python scripts/format_docs.py docs"


def test_every_page_has_its_tables():
    texts = {path.name: path.read_text(encoding="utf-8") for path in format_docs.documents(DOCS)}
    assert {name: text.count("<!-- formats: ") for name, text in texts.items()} == {"formats.md": 5, "README.md": 1}


def test_every_format_that_is_read_states_its_versions_contents_or_limits():
    silent = [known.name for known in recording_formats() if not known.recording.notes]
    silent += [known.name for known in calibration_formats() if not known.calibration.notes]
    silent += [known.name for known in formats_of(*format_docs.FUNCTIONS) if known.endings and not known.notes]
    assert silent == []


def test_an_aspect_without_words_on_the_page_is_refused(monkeypatch):
    monkeypatch.delitem(format_docs.ASPECTS, "kinds")
    with pytest.raises(ValueError, match=r"the page has no words for \{'kinds'\}"):
        format_docs.table("losses")


def test_the_rows_of_a_format_say_how_it_is_written():
    rows = [row.split(" | ") for row in format_docs.table("calibrations").split("\n")[2:]]
    ways = {name.removeprefix("| "): way for name, _, way, _ in rows}
    assert ways["DCM"] == "yes"
    assert ways["Excel"] == "as `.xlsx`"
    assert ways["PAR (CANape)"] == "into a copy of such a file"
