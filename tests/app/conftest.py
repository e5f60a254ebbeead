"""Small projects for the tests of the app."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from kennfeld.project.demo import write
from tests.app.app_processes import FORKS, end_forking_process, fork_workers, forking_process
from tests.app.browser import close_browser
from tests.app.shared_app import end_shared_app


@pytest.fixture(scope="session", autouse=True)
def end_shared_processes() -> Iterator[None]:
    yield
    close_browser()
    end_shared_app()
    end_forking_process()


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with demos, that of torque without a search along smoothed lookups, which takes half the time."""
    folder = tmp_path_factory.mktemp("demo")
    torque = write("torque", folder / "torque")
    text, automatic = torque.read_text(encoding="utf-8"), 'continuation = "auto" '
    assert automatic in text
    torque.write_text(text.replace(automatic, 'continuation = "off"  '), encoding="utf-8")
    write("exhaust", folder / "exhaust")
    for recording in (folder / "exhaust").glob("*.csv"):  # a quarter of each takes a quarter of the time to read
        lines = recording.read_text(encoding="utf-8").splitlines(keepends=True)
        recording.write_text("".join(lines[: len(lines) // 4]), encoding="utf-8")
    return folder


@pytest.fixture
def torque(demo_folder: Path, tmp_path: Path) -> Path:
    """Return the project file of a fresh copy of the torque demo."""
    shutil.copytree(demo_folder / "torque", tmp_path / "torque")
    return tmp_path / "torque" / "kennfeld.toml"


@pytest.fixture
def exhaust(demo_folder: Path, tmp_path: Path) -> Path:
    """Return the project file of a fresh copy of the exhaust demo."""
    shutil.copytree(demo_folder / "exhaust", tmp_path / "exhaust")
    return tmp_path / "exhaust" / "kennfeld.toml"


@pytest.fixture
def forked_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start the processes of calibrations and trainings without new interpreters."""
    if FORKS:
        fork_workers(monkeypatch, forking_process())
