"""The requests of a project for consent are those of its files as they are now."""

import os
from pathlib import Path

import pytest

from kennfeld.project import Project
from kennfeld.project.consent import consent_requests

TOML = """\
model.file = "m.kf"
functions.f = "f.py:f"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "m"
target = "y"
"""
TRANSLATED = "def f(x):\n    return 2.0 * x + 0.0 * 12345678901.2345678\n"
RUN = "def f(x):\n    open('written', 'w')\n    return 2.0 * x\n"


@pytest.mark.guests
def test_changed_code_of_the_same_size_and_time_needs_consent(tmp_path: Path) -> None:
    file = tmp_path / "f.py"
    file.write_text(TRANSLATED, encoding="utf-8")
    (tmp_path / "m.kf").write_text("input x\nm = f(x)\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(TOML, encoding="utf-8")
    project = Project.read(tmp_path / "kennfeld.toml").file
    assert consent_requests(project) == ()
    status = file.stat()
    file.write_text(RUN.ljust(len(TRANSLATED), "#"), encoding="utf-8")
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert file.stat().st_size == status.st_size
    assert [request.text for request in consent_requests(project)] == ["runs code of f.py"]
    file.unlink()
    assert consent_requests(project) == ()
