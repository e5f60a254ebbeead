"""Recordings in compressed files and archives."""

import bz2
import gzip
import lzma
import random
import zipfile

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from kennfeld.errors import InputError
from kennfeld.files import unpacking as module
from kennfeld.measurement import describe, read

CSV = b"time,Speed\n0,900\n0.1,950\n"


@pytest.fixture
def recording(tmp_path):
    """The bytes of a file that readers must seek in."""
    parquet.write_table(pa.table({"time": [0.0, 0.1], "Speed": [900.0, 950.0]}), tmp_path / "drive.parquet")
    return (tmp_path / "drive.parquet").read_bytes()


def zipped(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


@pytest.mark.parametrize(("ending", "pack"), [(".gz", gzip.compress), (".bz2", bz2.compress), (".xz", lzma.compress)])
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_compressed_files_are_read(tmp_path, recording, ending, pack, kind):
    path = tmp_path / f"drive.{kind}{ending}"
    path.write_bytes(pack(CSV if kind == "csv" else recording))
    data = read(path)
    assert data.name == "drive"
    assert data["Speed"].values.tolist() == [900.0, 950.0]
    assert data.time.tolist() == [0.0, 0.1]
    assert describe(path).tables[0].samples == 2


def test_the_only_file_of_an_archive_is_read(tmp_path, recording):
    path = zipped(tmp_path / "drives.zip", {"data/drive.parquet": recording, "__MACOSX/x": b""})
    assert read(path)["Speed"].values.tolist() == [900.0, 950.0]


def test_one_of_several_files_is_named_after_a_hash(tmp_path, recording):
    path = zipped(tmp_path / "drives.zip", {"mon/drive.parquet": recording, "tue/drive.csv": CSV})
    assert read(f"{path}#tue/drive.csv")["Speed"].values.tolist() == [900.0, 950.0]
    assert read(f"{path}#drive.parquet").name == "drive"
    with pytest.raises(InputError, match=r"holds 2 files: mon/drive.parquet.*Name one: drives.zip#mon/drive.parquet"):
        read(path)
    with pytest.raises(InputError, match=r"has no files named tue/drive.csx\. Did you mean tue/drive.csv\?"):
        read(f"{path}#tue/drive.csx")


DIADEM = (
    b"DIAEXTENDED\n#BEGINGLOBALHEADER\n#ENDGLOBALHEADER\n#BEGINCHANNELHEADER\n200,Speed\n210,EXPLICIT\n"
    b"211,run.r64\n213,CHANNEL\n214,REAL64\n220,3\n221,1\n#ENDCHANNELHEADER\n"
)


def test_files_beside_a_header_in_an_archive_are_read(tmp_path, monkeypatch):
    members = {"mon/run.dat": DIADEM, "mon/run.r64": np.arange(3.0).tobytes(), "tue/run.r64": bytes(24)}
    path = zipped(tmp_path / "runs.zip", members)
    assert read(f"{path}#run.dat")["Speed"].values.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(InputError, match=r"file run\.r64 is not beside the header"):
        read(str(zipped(tmp_path / "alone.zip", {"run.dat": DIADEM, "tue/run.r64": bytes(24)})) + "#run.dat")
    monkeypatch.setattr(module, "_HARMLESS", len(DIADEM) + 10)
    monkeypatch.setattr(module, "_MAX_RATIO", 0)
    with pytest.raises(InputError, match="unpack to more than"):
        read(f"{path}#run.dat")


def test_what_is_compressed_twice_or_empty_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"drive\.csv\.gz in it is compressed as well"):
        read(zipped(tmp_path / "twice.zip", {"drive.csv.gz": gzip.compress(CSV)}))
    with pytest.raises(InputError, match="the archive holds no files"):
        read(zipped(tmp_path / "empty.zip", {".hidden": b""}))


def test_bombs_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_HARMLESS", 1000)
    monkeypatch.setattr(module, "_CHUNK", 1000)
    path = tmp_path / "bomb.mf4.gz"
    path.write_bytes(gzip.compress(b"MDF     4.10" + bytes(10_000_000)))
    with pytest.raises(InputError, match=r"bomb\.mf4\.gz: its 0\.0 MB unpack to more than"):
        read(path)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress])
def test_damaged_files_are_refused(tmp_path, recording, pack):
    path, content, generator = tmp_path / "drive.parquet.x", pack(recording), random.Random(2)
    for _ in range(60):
        mutant = bytearray(content[: generator.randrange(10, len(content))])
        for _ in range(generator.randint(0, 3)):
            mutant[generator.randrange(10, len(mutant))] = generator.randrange(256)
        path.write_bytes(mutant)
        with pytest.raises(InputError):
            read(path)


def test_numbers_are_those_of_the_plain_file(tmp_path):
    values = np.random.default_rng(1).normal(size=5000)
    parquet.write_table(pa.table({"x": values}), tmp_path / "a.parquet")
    path = zipped(tmp_path / "a.zip", {"a.parquet": (tmp_path / "a.parquet").read_bytes()})
    np.testing.assert_array_equal(read(path)["x"].values, values)
