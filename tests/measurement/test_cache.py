"""Recordings that need not be read twice."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base import file_state
from kennfeld.base.errors import InputError
from kennfeld.base.file_state import FileState
from kennfeld.measurement import cache as caching
from kennfeld.measurement.bus_databases import to_databases
from kennfeld.measurement.cache import Cache
from kennfeld.measurement.reader import read_leniently
from tests.measurement.bus_files import DBC, drive, write_mf4
from tests.measurement.test_diadem import GLOBAL, explicit

TEXT = "time [s],Speed [rpm],Torque [Nm]\n0,1000,10\n0.1,1100,\n0.2,1200,12\n"


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A file, and a cache that keeps whatever is read."""
    monkeypatch.setattr(caching, "_worth", lambda source: 0.0)
    return Shelf(tmp_path, monkeypatch)


class Shelf:
    def __init__(self, folder, monkeypatch):
        self.folder, self.file = folder / "cache", folder / "bench.csv"
        self.patch = monkeypatch
        self.cache = Cache(self.folder)
        self.reads = 0
        self.write(TEXT)
        monkeypatch.setattr(caching, "read_leniently", self._read)

    def _read(self, *arguments):
        self.reads += 1
        return read_leniently(*arguments)

    def write(self, text):
        self.file.write_text(text, encoding="utf-8")
        self.age()

    def age(self, seconds=1e5):
        """As if it had been written long ago."""
        stat = self.file.stat()
        os.utime(self.file, ns=(stat.st_atime_ns, stat.st_mtime_ns - int(seconds * 1e9)))

    @property
    def entries(self):
        return sorted(self.folder.glob("*.parquet"))

    def speed(self, *arguments):
        return self.cache.read(self.file, *arguments)["Speed"].values.tolist()


def test_a_second_read_gives_the_same_without_the_reader(kept):
    first, second = kept.cache.read(kept.file), kept.cache.read(kept.file)
    assert kept.reads == 1
    assert second.name == first.name == "bench"
    assert second.time.tolist() == first.time.tolist()
    for one, other in zip(first.channels, second.channels, strict=True):
        assert (one.name, one.unit, one.description) == (other.name, other.unit, other.description)
        assert one.values.view(np.uint64).tolist() == other.values.view(np.uint64).tolist()


def test_other_channels_and_another_raster_are_read_for_themselves(kept):
    for arguments in ((None, None), (["Speed"], None), (["Speed"], 0.05), (["Speed", "Torque"], 0.05)):
        assert kept.cache.read(kept.file, *arguments).samples == (5 if arguments[1] else 3)
        kept.cache.read(kept.file, *arguments)
    assert kept.reads == len(kept.entries) == 4


def test_keeping_a_recording_does_not_load_pandas():
    code = (
        "import sys; from kennfeld.domain.dataset import Dataset;"
        "from kennfeld.measurement.cache import from_parquet, to_parquet;"
        "content = to_parquet(Dataset.of('bench', {'Speed': [1.0, float('nan')]}));"
        "print(from_parquet(content, 'bench')['Speed'].values.tolist(), 'pandas' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[1.0, nan] False"


def test_sheets_of_a_workbook_are_kept_apart(kept):
    import pandas as pd

    book = kept.file.with_name("book.xlsx")
    with pd.ExcelWriter(book) as writer:
        for sheet in (1, 2):
            pd.DataFrame({"Speed": [1000.0 * sheet]}).to_excel(writer, sheet_name=f"s{sheet}", index=False)
    for _ in range(2):
        assert [kept.cache.read(f"{book}#s{i}")["Speed"].values[0] for i in (1, 2)] == [1000, 2000]
    assert kept.reads == 2


def test_a_changed_file_is_read_again_and_its_old_entries_are_removed(kept):
    kept.speed()
    kept.speed(["Speed"])
    kept.write(TEXT.replace("1000", "1001"))
    assert kept.speed() == [1001, 1100, 1200]
    assert len(kept.entries) == 1


def test_a_byte_that_changes_behind_the_size_and_the_time_of_the_content_is_noticed(kept):
    kept.speed()
    stat = kept.file.stat()
    kept.file.write_text(TEXT.replace("1000", "1001"), encoding="utf-8")
    os.utime(kept.file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert kept.file.stat().st_mtime_ns == stat.st_mtime_ns
    assert kept.speed() == [1001, 1100, 1200]


def test_a_file_that_was_touched_alone_is_not_read_anew(kept):
    kept.speed()
    os.utime(kept.file)
    assert kept.speed() == [1000, 1100, 1200]
    assert kept.reads == 1


def test_the_content_is_hashed_where_the_file_changed_and_not_otherwise(kept):
    hashed = []
    state_of = FileState.of
    kept.patch.setattr(FileState, "of", lambda path: hashed.append(path) or state_of(path))
    kept.patch.setattr(file_state, "SETTLED", -1)
    for _ in range(3):
        kept.speed()
    assert len(hashed) == 1
    os.utime(kept.file)
    kept.speed()
    kept.speed()
    assert len(hashed) == 2


def test_a_file_that_was_written_a_moment_ago_is_hashed_each_time(kept):
    hashed = []
    state_of = FileState.of
    kept.patch.setattr(FileState, "of", lambda path: hashed.append(path) or state_of(path))
    for _ in range(3):
        kept.speed()
    assert len(hashed) == 3
    assert kept.reads == 1


def test_a_moved_or_copied_file_is_read_for_itself_and_named_for_itself(kept):
    kept.speed()
    other = kept.file.with_name("other.csv")
    other.write_bytes(kept.file.read_bytes())
    assert kept.cache.read(other).name == "other"
    assert kept.cache.read(other).name == "other"


@pytest.mark.parametrize("place", [0, 5, 100, -100, -5, -1])
def test_a_damaged_entry_is_ignored(kept, place):
    kept.speed()
    [entry] = kept.entries
    content = bytearray(entry.read_bytes())
    content[place] ^= 1
    entry.write_bytes(content)
    assert kept.speed() == [1000, 1100, 1200]
    assert kept.reads == 2
    assert kept.speed() == [1000, 1100, 1200]
    assert kept.reads == 2


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"content": "*"}', "null", "\0\0", "[" * 100_000])
def test_a_damaged_note_is_ignored(kept, text):
    kept.speed()
    [note] = kept.folder.glob("*.json")
    note.write_text(text, encoding="utf-8")
    assert kept.speed() == [1000, 1100, 1200]
    assert kept.reads == 2


def test_a_note_that_names_a_pattern_is_damaged(kept):
    kept.speed()
    [note] = kept.folder.glob("*.json")
    content = kept.entries[0].name.split("-")[0]
    note.write_text(note.read_text().replace(content, "*"), encoding="utf-8")
    kept.speed()
    assert kept.reads == 2


def test_a_folder_that_cannot_be_created_is_not_used_as_cache(kept):
    kept.folder.write_text("a file", encoding="utf-8")
    assert kept.speed() == [1000, 1100, 1200]
    assert kept.speed() == [1000, 1100, 1200]
    assert kept.reads == 2


def test_a_full_disk_is_not_used_as_cache(kept):
    def full(*_):
        raise OSError(28, "No space left on device")

    kept.patch.setattr(caching, "write_whole", full)
    assert kept.speed() == [1000, 1100, 1200]
    assert kept.entries == []


def test_findings_of_the_reader_come_through(kept):
    kept.write(TEXT.replace("1100", "x"))
    for _ in range(2):
        with pytest.raises(InputError, match=r"bench.csv line 3, column Speed: must be a number, got 'x'"):
            kept.cache.read(kept.file)
    with pytest.raises(InputError, match="there is no such file"):
        kept.cache.read(kept.file.with_name("none.csv"))


def test_the_least_recently_used_entry_is_evicted_first(kept):
    kept.speed(["Speed"], 0.1)
    size = kept.entries[0].stat().st_size
    kept.cache = Cache(kept.folder, most=2 * size + size // 2)
    kept.speed(["Speed"], 0.05)
    for entry, age in zip(sorted(kept.entries, key=os.path.getmtime), (300, 200), strict=True):
        os.utime(entry, (1e9 - age, 1e9 - age))
    kept.speed(["Speed"], 0.1)
    assert kept.reads == 2
    kept.speed(["Speed"], 0.02)
    assert kept.reads == 3
    kept.speed(["Speed"], 0.1)
    assert kept.reads == 3
    kept.speed(["Speed"], 0.05)
    assert kept.reads == 4


def test_entries_larger_than_the_folder_limit_are_not_kept(kept):
    kept.cache = Cache(kept.folder, most=10)
    kept.speed()
    assert kept.entries == []


def test_a_file_that_changes_while_it_is_read_is_not_kept(kept):
    def changing(*arguments):
        table = read_leniently(*arguments)
        kept.write(TEXT + "0.3,1300,13\n")
        return table

    kept.patch.setattr(caching, "read_leniently", changing)
    kept.speed()
    assert kept.entries == []


def test_half_written_files_of_another_run_are_removed_after_a_while(kept):
    kept.folder.mkdir()
    for name, mtime in ((".old.parquet.1-2", 1e9), (".new.parquet.1-2", None)):
        (kept.folder / name).write_text("half")
        os.utime(kept.folder / name, None if mtime is None else (mtime, mtime))
    kept.speed()
    assert [path.name for path in kept.folder.glob(".*-*")] == [".new.parquet.1-2"]


def test_several_runs_at_once_read_the_same(kept):
    speeds = []
    runs = [threading.Thread(target=lambda: speeds.append(kept.speed(["Speed"], 0.1))) for _ in range(8)]
    for run in runs:
        run.start()
    for run in runs:
        run.join()
    assert speeds == [[1000, 1100, 1200]] * 8
    assert len(kept.entries) == 1
    assert not list(kept.folder.glob(".*-*"))


def test_the_folder_ignores_itself(kept):
    kept.speed()
    assert (kept.folder / ".gitignore").read_text() == "*\n"


def test_another_version_of_the_readers_reads_anew(kept):
    kept.speed()
    kept.patch.setattr(caching, "code_digest", lambda: "another")
    kept.speed()
    assert kept.reads == 2


def test_a_bus_log_is_read_again_if_a_database_changes(kept, tmp_path):
    path = write_mf4(tmp_path / "drive.mf4", drive())
    database = tmp_path / "engine.dbc"
    database.write_text(DBC)

    def temp(**settings):
        databases = to_databases({"file": str(database), **settings})
        return kept.cache.read(path, ["Temp"], databases=databases)["Temp"].values[0]

    assert (temp(), temp(), kept.reads) == (80.0, 80.0, 1)
    assert (temp(bus=1), kept.reads) == (80.0, 2)
    database.write_text(DBC.replace("(1,-40)", "(2,-40)"))
    assert (temp(), temp(), kept.reads) == (200.0, 200.0, 3)


def test_a_small_text_file_is_not_kept(tmp_path):
    (tmp_path / "bench.csv").write_text(TEXT, encoding="utf-8")
    Cache(tmp_path / "cache").read(tmp_path / "bench.csv")
    assert not Path(tmp_path / "cache").exists()


@pytest.mark.parametrize(
    ("name", "raster"),
    [
        ("mdf/asammdf_test_batch.mf4", None),
        ("mdf/asammdf_ASAP2_Demo_V171.mf4", 0.1),
        ("engine_steady/engine1_normalized.xlsx#data", None),
        ("engine_transient/gengine1_m10.csv.gz", 0.2),
        ("cascaded_tanks/dataBenchmark.csv", None),
    ],
)
def test_real_recordings_come_back_bit_for_bit(kept, real, name, raster):
    path, _, sheet = name.partition("#")
    path = f"{real(path)}{'#' * bool(sheet)}{sheet}"
    first, second = kept.cache.read(path, None, raster), kept.cache.read(path, None, raster)
    assert kept.reads == 1
    assert [(c.name, c.unit, c.description) for c in second.channels] == [
        (c.name, c.unit, c.description) for c in first.channels
    ]
    for one, other in zip(first.channels, second.channels, strict=True):
        assert one.values.tobytes() == other.values.tobytes()
    assert (first.time is None) == (second.time is None)
    assert first.time is None or first.time.tobytes() == second.time.tobytes()


def replace_unseen(path, content):
    """Write other bytes of the same number, under the time of the old ones."""
    stat = path.stat()
    path.write_bytes(content)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def test_files_of_values_beside_a_header_count(kept):
    header = kept.file.with_suffix(".dat")
    channel = explicit("Speed", "bench.r64", "REAL64", 3, unit="rpm")
    header.write_text(f"{GLOBAL}#ENDGLOBALHEADER\n\n{channel}", encoding="latin-1")
    header.with_name("bench.r64").write_bytes(np.array([1.0, 2.0, 3.0]).tobytes())
    assert [kept.cache.read(header)["Speed"].values[0] for _ in range(2)] == [1.0, 1.0]
    assert kept.reads == 1
    replace_unseen(header.with_name("bench.r64"), np.array([7.0, 2.0, 3.0]).tobytes())
    assert kept.cache.read(header)["Speed"].values[0] == 7.0
    header.with_name("bench.r64").unlink()
    with pytest.raises(InputError, match=r"bench\.r64"):
        kept.cache.read(header)


def test_a_relative_database_is_that_of_the_present_folder(kept, tmp_path, monkeypatch):
    values = []
    for folder, factor in (("first", "1"), ("second", "2")):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        Path("engine.dbc").write_text(DBC.replace("(1,-40)", f"({factor},-40)"), encoding="utf-8")
        write_mf4(Path("drive.mf4"), drive())
        values.append(kept.cache.read("drive.mf4", ["Temp"], databases=to_databases("engine.dbc"))["Temp"].values[0])
    assert values == [80.0, 200.0]
