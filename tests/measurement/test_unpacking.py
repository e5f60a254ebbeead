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

from kennfeld.base.errors import InputError
from kennfeld.calfiles import read as read_calibration
from kennfeld.measurement import describe, read
from kennfeld.measurement.reader import _readable

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
    members["mon/other.r64"] = bytes(100_000)
    zipped(path, members)
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 10_000)
    with pytest.raises(InputError, match=r"suspicious archive: mon/other\.r64 holds 0 MB or more"):
        read(f"{path}#run.dat")


def test_doubly_compressed_and_empty_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"drive\.csv\.gz in it is compressed as well"):
        read(zipped(tmp_path / "twice.zip", {"drive.csv.gz": gzip.compress(CSV)}))
    with pytest.raises(InputError, match="the archive holds no files"):
        read(zipped(tmp_path / "empty.zip", {".hidden": b""}))


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress])
@pytest.mark.parametrize("content", [b"MDF     4.10" + bytes(1_000_000), b"time,Speed\n" + b"1,900\n" * 200_000])
def test_bombs_are_refused(tmp_path, monkeypatch, pack, content):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 1000)
    path = tmp_path / "bomb.x"
    path.write_bytes(pack(content))
    with pytest.raises(InputError, match=r"bomb\.x: its .* MB unpack to more than 0 MB, \d+ times its size\. Unpack"):
        read(path)


def test_bombs_that_claim_to_be_calibrations_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 1000)
    path = tmp_path / "start.dcm.gz"
    path.write_bytes(gzip.compress(b"KONSERVIERUNG_FORMAT 2.0\n" + b"* note\n" * 100_000))
    with pytest.raises(InputError, match=r"start\.dcm\.gz: its .* MB unpack to more than 0 MB, \d+ times its size"):
        read_calibration(path)


@pytest.mark.slow
def test_a_log_of_an_engine_at_rest_that_packs_a_hundredfold_is_read(tmp_path):
    rows = "".join(f"{k / 10:.1f},0,20,101.3,0,0,12.5,0,0,0,0,0,0,ready\n" for k in range(20_000))
    path = tmp_path / "rest.csv.xz"
    path.write_bytes(lzma.compress(b"time,Speed,T,p,a,b,U,c,d,e,f,g,h,State\n" + rows.encode()))
    assert len(rows) > 80 * path.stat().st_size
    assert read(path).samples == 20_000


def test_memory_of_an_unpacked_file_is_in_proportion_to_the_packed_one(tmp_path, recording):
    path = tmp_path / "drive.parquet.gz"
    path.write_bytes(gzip.compress(recording))
    with _readable(path, None) as source:
        assert source.size == len(recording)
        assert source.stored_size() == path.stat().st_size


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
