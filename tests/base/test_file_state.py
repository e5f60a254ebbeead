"""What is remembered of files is remembered while all of them are the same, and no longer."""

import os
import threading
import time

import pytest

from kennfeld.base import file_state
from kennfeld.base.file_state import FileVersion, content_of, note_opened, opened_files, version_of, while_unchanged


class Reader:
    """Reads a file and one beside it, and counts how often."""

    def __init__(self, folder):
        self.file, self.beside = folder / "a.txt", folder / "b.txt"
        self.reads = 0
        self.file.write_text("1", encoding="utf-8")
        self.look = while_unchanged(2)(self._read)

    def _read(self, path, factor=1):
        self.reads += 1
        note_opened(self.beside)
        return factor * int(path.read_text()) + (int(self.beside.read_text()) if self.beside.is_file() else 0)


@pytest.fixture
def reader(tmp_path):
    return Reader(tmp_path)


def age(path):
    """As if it had been written long ago, as far as a file's times can say it."""
    stat = path.stat()
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns - 10**14))


def replace_unseen(path, text):
    """Write a text of the same size, and give the file the time of the old one."""
    stat = path.stat()
    path.write_text(text, encoding="utf-8")
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def test_a_file_is_read_once(reader):
    assert [reader.look(reader.file) for _ in range(3)] == [1, 1, 1]
    assert reader.reads == 1


def test_a_file_of_the_same_size_and_time_is_another_one(reader):
    age(reader.file)
    reader.look(reader.file)
    replace_unseen(reader.file, "7")
    assert reader.look(reader.file) == 7


def test_a_change_within_the_tick_of_the_clock_is_seen_in_the_content(reader, monkeypatch):
    times = file_state._times
    monkeypatch.setattr(file_state, "_times", lambda path: (1, *[time.time_ns()] * 2) if times(path) else ())
    assert reader.look(reader.file) == 1
    monkeypatch.setattr(file_state, "_times", times)
    reader.file.write_text("7", encoding="utf-8")
    assert reader.look(reader.file) == 7


def test_a_companion_that_changes_appears_or_goes_counts(reader):
    assert reader.look(reader.file) == 1
    reader.beside.write_text("10", encoding="utf-8")
    assert reader.look(reader.file) == 11
    age(reader.beside)
    reader.look(reader.file)
    replace_unseen(reader.beside, "20")
    assert reader.look(reader.file) == 21
    reader.beside.unlink()
    assert reader.look(reader.file) == 1


def test_a_relative_path_means_the_file_of_the_present_folder(reader, tmp_path, monkeypatch):
    other = tmp_path / "other"
    other.mkdir()
    (other / "a.txt").write_text("5", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    name = reader.file.relative_to(tmp_path)
    assert reader.look(name) == 1
    monkeypatch.chdir(other)
    assert reader.look(name) == 5


def test_other_arguments_are_another_result(reader):
    assert [reader.look(reader.file, factor) for factor in (1, 2)] == [1, 2]
    assert reader.look(reader.file, factor=3) == 3


def test_content_that_changes_while_it_is_read_is_not_kept(reader):
    def read(path):
        text = path.read_text()
        path.write_text(text + "1", encoding="utf-8")
        return text

    look = while_unchanged(2)(read)
    assert [look(reader.file), look(reader.file)] == ["1", "11"]


def test_what_an_inner_memory_returns_counts_for_the_outer_one(reader):
    outer = while_unchanged(2)(lambda: reader.look(reader.file))
    assert [reader.look(reader.file), outer(), outer()] == [1, 1, 1]
    reader.file.write_text("3", encoding="utf-8")
    assert outer() == 3


def test_files_that_threads_open_count(tmp_path):
    path = tmp_path / "a.txt"
    with opened_files() as opened:
        thread = threading.Thread(target=note_opened, args=(path,))
        thread.start()
        thread.join()
    assert list(opened) == [path]


def test_errors_are_not_kept(tmp_path):
    look = while_unchanged(2)(lambda path: path.read_text())
    with pytest.raises(OSError, match=r"a\.txt"):
        look(tmp_path / "a.txt")
    (tmp_path / "a.txt").write_text("1", encoding="utf-8")
    assert look(tmp_path / "a.txt") == "1"


def test_the_least_used_result_is_removed(reader):
    for factor in (1, 2, 3, 1):
        reader.look(reader.file, factor)
    assert reader.reads == 4


def test_the_names_in_a_folder_are_its_content(tmp_path):
    before, version = content_of(tmp_path), version_of([tmp_path])
    (tmp_path / "a").touch()
    assert content_of(tmp_path) != before
    assert version_of([tmp_path]) != version


def test_a_version_is_seen_to_end(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1", encoding="utf-8")
    version = FileVersion.seen(path, file_state._times(path))
    assert version.is_present
    path.write_text("2", encoding="utf-8")
    assert not version.is_present
    assert version.now().is_present


def test_a_file_that_cannot_be_read_has_no_version_twice(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    path.write_text("1", encoding="utf-8")
    monkeypatch.setattr(file_state.FileState, "of", lambda path: (_ for _ in ()).throw(PermissionError(path)))
    assert version_of([path]) != version_of([path])


def test_another_file_of_the_same_size_and_times_is_another_one(reader, tmp_path, monkeypatch):
    """As two recordings that were copied together, and whose folders are renamed."""
    other = tmp_path / "other.txt"
    other.write_text("7", encoding="utf-8")
    times = file_state._times_of(reader.file.stat())[:3]
    of = file_state._times_of
    monkeypatch.setattr(file_state, "_times_of", lambda stat: (*times, *of(stat)[3:]))
    monkeypatch.setattr(file_state, "SETTLED", -1)
    assert reader.look(reader.file) == 1
    other.replace(reader.file)
    assert reader.look(reader.file) == 7
