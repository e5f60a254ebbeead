"""Files that are replaced together, whatever kills the process."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from kennfeld.project.folder_replacement import finish_interrupted, move, scratch_folder
from tests.draws import mostly_slow

NAMES = ["a", "b", "c"]
posix = pytest.mark.skipif(os.name != "posix", reason="kills a process")


@pytest.fixture
def folder(tmp_path):
    fill(tmp_path, "old")
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    return tmp_path


def fill(folder, text):
    for name in NAMES:
        (folder / name).write_text(f"{text} {name}", encoding="utf-8")


def replace_all(folder):
    with scratch_folder(folder) as scratch:
        fill(scratch, "new")
        move(NAMES, scratch, folder)


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_text(encoding="utf-8") for path in sorted(folder.iterdir())}


def expected(text):
    return {name: f"{text} {name}" for name in NAMES} | {"notes.txt": "mine"}


DYING = """
import os, signal, sys
from pathlib import Path
from kennfeld.project.folder_replacement import move, scratch_folder

folder, left, replace = Path(sys.argv[1]), [None] * int(sys.argv[2]), Path.replace

def dying(self, target):
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
    left.pop()
    replace(self, target)

Path.replace = dying
with scratch_folder(folder) as scratch:
    for name in "abc":
        (scratch / name).write_text(f"new {name}")
    if sys.argv[3:]:
        os.kill(os.getpid(), signal.SIGKILL)
    move("abc", scratch, folder)
"""


def die(folder, renames, *before):
    """Replace files in a process that is killed before the rename after so many, or before all else."""
    command = [sys.executable, "-c", DYING, str(folder), str(renames), *before]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert len(leftovers(folder)) == 1


def leftovers(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".kennfeld")]


def test_files_are_replaced_without_leaving_others(folder):
    replace_all(folder)
    assert contents(folder) == expected("new")


@pytest.mark.slow
@posix
@pytest.mark.parametrize("renames", mostly_slow(range(len(NAMES)), 1))
def test_a_replacement_of_a_killed_process_is_completed_by_the_next_one(folder, renames):
    die(folder, renames)
    finish_interrupted(folder)
    assert contents(folder) == expected("new")


@posix
def test_incomplete_files_of_a_process_are_removed(folder):
    die(folder, 0, "before")
    with scratch_folder(folder) as scratch:
        assert leftovers(folder) == [scratch.name]
    assert contents(folder) == expected("old")


def test_the_scratch_folder_of_a_running_process_stays(folder):
    with scratch_folder(folder) as scratch:
        fill(scratch, "new")
        replace_all(folder)
        finish_interrupted(folder)
        assert {path.name for path in scratch.iterdir()} == {*NAMES, "lock"}
    assert leftovers(folder) == []


def test_a_folder_of_an_older_version_is_removed_but_not_one_of_a_user(folder):
    (folder / ".kennfeld-4711").mkdir()
    (folder / ".kennfeld-mine").mkdir()
    (folder / ".kennfeld").mkdir()
    finish_interrupted(folder)
    assert sorted(leftovers(folder)) == [".kennfeld", ".kennfeld-mine"]


def test_an_incomplete_list_of_names_is_ignored(folder):
    scratch = folder / ".kennfeld-0"
    scratch.mkdir()
    fill(scratch, "new")
    (scratch / "names").write_text('["a", "b', encoding="utf-8")
    finish_interrupted(folder)
    assert contents(folder) == expected("old")


def test_everything_is_on_the_disk_before_the_first_file_is_replaced(folder, monkeypatch):
    steps, replace = [], Path.replace
    monkeypatch.setattr(os, "fsync", lambda number: steps.append("sync"))
    monkeypatch.setattr(Path, "replace", lambda self, target: (steps.append(self.name), replace(self, target))[1])
    replace_all(folder)
    assert "sync" not in steps[steps.index("a") : steps.index("c")]
    assert steps[: steps.index("a")].count("sync") >= len(NAMES) + 1
    assert steps[-1] in ("sync", "c" if os.name == "nt" else "sync")


def test_a_disk_that_is_full_when_files_are_written_through_leaves_the_old_ones(folder, monkeypatch):
    def full(number):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        replace_all(folder)
    assert contents(folder) == expected("old")


def test_a_folder_that_another_process_removes_is_created_again(tmp_path, monkeypatch):
    folder, tokens = tmp_path / "results", ["1", "2"]

    def token(size):
        if len(tokens) == 2:
            folder.rmdir()
        return tokens.pop(0)

    monkeypatch.setattr("kennfeld.project.folder_replacement.secrets.token_hex", token)
    with scratch_folder(folder) as scratch:
        assert scratch.name == ".kennfeld-2"


def test_finishing_a_folder_that_does_not_exist_has_no_effect(tmp_path):
    finish_interrupted(tmp_path / "results")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "names", ['["../victim"]', '["/victim"]', '["a", "../victim"]', "7", "[7]", '{"a": 1}', "[" * 100_000]
)
def test_a_list_that_no_run_has_written_is_ignored(folder, names):
    (folder.parent / "victim").write_text("precious", encoding="utf-8")
    scratch = folder / ".kennfeld-0"
    scratch.mkdir()
    fill(scratch, "new")
    (folder / "victim").write_text("harm", encoding="utf-8")
    (scratch / "names").write_text(names, encoding="utf-8")
    finish_interrupted(folder)
    (folder / "victim").unlink()
    assert contents(folder) == expected("old")
    assert (folder.parent / "victim").read_text(encoding="utf-8") == "precious"


@posix
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_lock_that_is_not_a_file_is_not_opened(folder, kind):
    scratch = folder / ".kennfeld-0"
    scratch.mkdir()
    if kind == "link":
        (scratch / "lock").symlink_to(folder.parent / "made")
    else:
        os.mkfifo(scratch / "lock")
    finish_interrupted(folder)
    assert not (folder.parent / "made").exists()
    assert leftovers(folder) == [".kennfeld-0"]
