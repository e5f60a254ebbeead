"""Idiomatic technical English in what users and the next engineer read."""

import re
from pathlib import Path

import pytest

from tests.source_facts import FILES, SOURCE, facts_of

ROOT = Path(__file__).parents[1]
MESSAGES = {  # pattern: what to write instead
    r"(?<![Tt]here )\b(?:is|are) no (?!longer\b|more\b|fewer\b|less\b|effect\b|need\b)": "must be, unknown, is not a",
    r"\bleft aside\b": "skipped",
    r"\bmend(?:s|ed)?\b": "fix, remedy",
    r"\bfrom 0 on\b": ">= 0",
    r"\bhas no meaning\b": "requires ..., does not apply to ...",
    r"\bbesides? beside\b": "in addition to",
    r"\bstands already\b": "duplicate of ...",
    r"\bsays? no\b": "states no, does not state",
    r"[Ww]hat the data leave open": "not determined by the data",
}
DOCSTRINGS = {
    r"^(?:What|Whether|How|Why|Which)\b": "begin with a verb, or with a noun for a property",
    r"\bleft aside\b": "skipped",
    r"\bmend(?:s|ed)?\b": "fix, remedy",
    r"\bfrom 0 on\b": ">= 0",
}
DOCUMENTS = [
    *(
        ROOT / name
        for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "editors/vscode/README.md")
    ),
    *sorted((ROOT / "docs").rglob("*.md")),
]


def faults(patterns, text):
    return [f"{match[0]!r}: {better}" for pattern, better in patterns.items() for match in re.finditer(pattern, text)]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(SOURCE).as_posix())
def test_messages_and_docstrings_are_plain_english(path):
    facts = facts_of(path)
    assert [(line, fault) for line, text in facts.strings for fault in faults(MESSAGES, text)] == []
    assert [(line, fault) for line, text in facts.docstrings for fault in faults(DOCSTRINGS, text)] == []


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_documents_are_plain_english(path):
    assert faults(MESSAGES, path.read_text(encoding="utf-8")) == []
