"""Code that the user has agreed to run, by the digests of files."""

import os
from pathlib import Path

import pytest

from kennfeld.models import code_consent
from kennfeld.models.code_consent import allow, content_digest, is_allowed


@pytest.fixture(autouse=True)
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep what is allowed in a folder of the test, and forget what this process allows."""
    file = tmp_path / "kennfeld/allowed-code.json"
    monkeypatch.setattr(code_consent, "consent_file", lambda: file)
    monkeypatch.setattr(code_consent, "_allowed_here", set())
    return file


def forget_process() -> None:
    code_consent._allowed_here.clear()


def test_trusted_content_is_remembered_by_other_processes() -> None:
    assert not is_allowed("a")
    allow("a")
    forget_process()
    assert is_allowed("a")
    assert not is_allowed("b")


def test_the_digest_is_that_of_the_content(tmp_path: Path) -> None:
    for name, text in (("a", "1"), ("b", "1"), ("c", "2")):
        (tmp_path / name).write_text(text)
    digests = [content_digest(tmp_path / name) for name in "abc"]
    assert digests[0] == digests[1] != digests[2]


def test_the_oldest_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code_consent, "MAX_DIGESTS", 2)
    for digest in ("a", "b", "a", "c"):
        allow(digest)
    forget_process()
    assert [is_allowed(digest) for digest in "abc"] == [True, False, True]


@pytest.mark.parametrize("content", ["{", "{}", "[1, null]", "[" * 100_000])
def test_a_damaged_file_allows_nothing(memory: Path, content: str) -> None:
    memory.parent.mkdir()
    memory.write_text(content, encoding="utf-8")
    assert not is_allowed("a")
    allow("a")
    forget_process()
    assert is_allowed("a")


@pytest.mark.skipif(os.name != "posix", reason="needs permissions of POSIX")
def test_a_file_that_others_can_write_allows_nothing(memory: Path) -> None:
    allow("a")
    forget_process()
    memory.chmod(0o666)
    assert not is_allowed("a")


def test_without_a_file_the_process_remembers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code_consent, "consent_file", lambda: None)
    allow("a")
    assert is_allowed("a")
    forget_process()
    assert not is_allowed("a")
