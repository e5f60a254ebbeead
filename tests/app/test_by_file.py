"""The errors of a run by file, on the screen of the results."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.app.questions import QUESTIONS
from kennfeld.app.session.session import Session
from tests.app.shared_app import project_page
from tests.draws import mostly_slow

pytestmark = pytest.mark.usefixtures("forked_workers")

PROJECT = """
[model]
file = "model.kf"

[[dataset]]
name = "drives"
files = ["drive_*.csv"]

[parameters.a]
initial = 1.0

[[criterion]]
node = "y"
target = { channel = "m" }
"""


def write_project(folder: Path, files: int) -> Path:
    random = np.random.default_rng(0)
    for number in range(files):
        x = random.uniform(1, 3, 100)
        rows = [f"{a:.6g},{b:.6g}" for a, b in zip(x, 2 * x + random.normal(0, 0.1 + number, 100), strict=True)]
        (folder / f"drive_{number}.csv").write_text("\n".join(["x,m", *rows]) + "\n", encoding="utf-8")
    (folder / "model.kf").write_text("y = a * x\n", encoding="utf-8")
    (folder / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    return folder / "kennfeld.toml"


def calibrated(project: Path) -> Session:
    session = Session(project)
    session.run()
    deadline = time.monotonic() + 120
    while session.job.state == "running":
        assert time.monotonic() < deadline
        time.sleep(0.02)
        session.pump()
    return session


def ask(session: Session) -> dict[str, Any]:
    return dict(QUESTIONS["by-file"](session, {}).head)


@pytest.mark.parametrize("files", mostly_slow([1, 3], [3]))
def test_a_run_has_a_row_for_each_file_the_worst_first(tmp_path: Path, files: int) -> None:
    session = calibrated(write_project(tmp_path, files))
    head = ask(session)
    assert head["run"] == 1
    assert head["several"] is (files > 1)
    assert [row[0] for row in head["rows"]] == ["file", *(f"drive_{number}.csv" for number in reversed(range(files)))]
    assert head["rows"] == [list(row) for row in session.runs[-1].result.recordings_table()]


def test_nothing_is_listed_before_a_run(tmp_path: Path) -> None:
    head = ask(Session(write_project(tmp_path, 2)))
    assert (head["run"], len(head["rows"]), head["several"]) == (None, 1, False)


@pytest.mark.slow
@pytest.mark.parametrize("files", [1, 3])
def test_the_table_is_folded_if_there_is_only_one_file(tmp_path: Path, files: int) -> None:
    project = write_project(tmp_path, files)
    with project_page(project) as page:
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=60_000)
        page.click("[data-screen=results]")
        page.wait_for_selector("#by-file")
        if files == 1:
            assert page.query_selector("#files-table") is None
            page.click("#by-file button[aria-expanded]")
        page.wait_for_selector("#files-table")
        names = [row.inner_text().split()[0] for row in page.query_selector_all("#files-table tbody tr")]
        assert names == [f"drive_{number}.csv" for number in reversed(range(files))]
        page.click("#by-file button[aria-expanded]")
        page.wait_for_selector("#files-table", state="detached")
