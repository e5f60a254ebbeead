"""Plain MDF 4 files are read without the library, with the same result; everything else is left to it."""

import warnings
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import mdf, read
from kennfeld.measurement.sorted_mdf import SortedFile, UnusualLayoutError
from kennfeld.measurement.source import locate
from kennfeld.measurement.table import Selection
from tests.draws import mostly_slow

STAMPS = 0.01 * np.arange(5000)


def write(path, *signals, compression=0, version="4.10", **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF

        with MDF(version=version) as file:
            for group in signals:
                file.append(group, comment="bench", common_timebase=True, **more)
            return file.save(path, compression=compression, overwrite=True)


def signal(name, values, stamps=STAMPS, **more):
    from asammdf import Signal

    return Signal(np.asarray(values), stamps, name=name, **more)


def numbers(kind, samples=STAMPS.size):
    drawn = np.random.default_rng(3).integers(0, 120, samples)
    return drawn.astype(kind)


def by_library(path, selection):
    source = locate(path)
    with TemporaryDirectory() as folder, mdf._open(source, folder) as file:
        return mdf._read(source, file, selection)


def without_library(path, selection):
    source = locate(path)
    with SortedFile(source.path) as file:
        return mdf._read(source, file, selection)


def assert_equal(tables, others):
    for table, other in zip(tables, others, strict=True):
        for name in ("location", "names", "details", "clock_index", "findings"):
            assert getattr(table, name) == getattr(other, name)
        for column, wanted in zip(table.columns, other.columns, strict=True):
            assert column.values.tobytes() == wanted.values.tobytes()
            for name in ("name", "unit", "place", "held", "description", "texts"):
                assert getattr(column, name) == getattr(wanted, name)


@pytest.mark.parametrize("compression", [0, 1, 2])
@pytest.mark.parametrize("version", ["4.00", "4.10", "4.11"])
def test_every_type_of_number_is_read_as_by_the_library(tmp_path, version, compression):
    kinds = ["u1", "i1", "<u2", ">u2", "<i2", "<u4", ">i4", "<u8", "<i8", "<f4", ">f4", "<f8"]
    path = write(
        tmp_path / "bench.mf4",
        [signal(f"plain {kind}", numbers(kind), unit="rpm") for kind in kinds],
        [
            signal(f"scaled {kind}", numbers(kind), unit="Nm", conversion={"a": 0.1, "b": b}, comment="a remark")
            for kind, b in (("<u2", 0.0), ("<i2", -3.7), ("<f4", 1.5))
        ],
        version=version,
        compression=compression,
    )
    assert_equal(without_library(path, Selection()), by_library(path, Selection()))
    chosen = Selection(("scaled <i2", "plain >u2"))
    assert_equal(without_library(path, chosen), by_library(path, chosen))


@pytest.mark.parametrize("compression", mostly_slow([0, 2], [2]))
def test_records_may_lie_in_many_blocks(tmp_path, compression):
    stamps = 0.001 * np.arange(400_000)
    values = np.random.default_rng(0).normal(size=(4, stamps.size))
    signals = [signal(f"x{i}", row, stamps) for i, row in enumerate(values)]
    path = write(tmp_path / "bench.mf4", signals, compression=compression)
    assert_equal(without_library(path, Selection()), by_library(path, Selection()))


def test_channels_that_no_one_reads_may_be_of_any_kind(tmp_path):
    texts = signal("Mode", np.array([b"idle", b"run"] * (STAMPS.size // 2)), encoding="utf-8")
    enumeration = signal("Gear", numbers("u1"), conversion={"val_0": 0, "text_0": "N", "val_1": 1, "text_1": "D"})
    path = write(tmp_path / "bench.mf4", [signal("Speed", numbers("<f4")), texts, enumeration])
    assert_equal(without_library(path, Selection(("Speed",))), by_library(path, Selection(("Speed",))))
    for name in ("Mode", "Gear"):
        assert_equal(without_library(path, Selection((name,))), by_library(path, Selection((name,))))
        assert_equal(mdf.read_tables(locate(path), Selection((name,))), by_library(path, Selection((name,))))


@pytest.mark.parametrize("file", ["asammdf_ASAP2_Demo_V171.mf4", "asammdf_test_batch.mf4", "asammdf_test_metadata.mf4"])
def test_recordings_of_other_tools_are_read_as_by_the_library(real, file):
    path = real(f"mdf/{file}")
    try:
        with SortedFile(path) as plain:
            names = [entry.name for entry in mdf._entries(locate(path), plain, None)]
    except UnusualLayoutError:
        return  # other tests read it with the library
    with TemporaryDirectory() as folder, mdf._open(locate(path), folder) as other:
        assert names == [entry.name for entry in mdf._entries(locate(path), other, None)]
    for name in names[::5]:
        with_fallback = mdf.read_tables(locate(path), Selection((name,)))
        assert_equal(with_fallback, by_library(path, Selection((name,))))


def test_the_library_is_not_loaded_for_a_plain_file(tmp_path, monkeypatch):
    path = write(tmp_path / "bench.mf4", [signal("Speed", numbers("<f4"))])
    monkeypatch.setattr(mdf, "_use_library", lambda *_: pytest.fail("the library was used"))
    assert read(path, ["Speed"])["Speed"].values.tobytes() == numbers("<f8").tobytes()


def test_missing_channels_are_reported_as_by_the_library(tmp_path):
    path = write(tmp_path / "bench.mf4", [signal("Speed", numbers("<f4"))])
    with pytest.raises(InputError) as caught:
        read(path, ["Spede"])
    assert str(caught.value) == "bench.mf4: has no channel Spede. Did you mean Speed?"


@pytest.mark.parametrize("compression", [0, 2])
def test_a_file_that_is_cut_off_is_left_to_the_library(tmp_path, compression):
    path = write(tmp_path / "bench.mf4", [signal("Speed", numbers("<f4"))], compression=compression)
    content = path.read_bytes()
    refused = 0
    for size in range(0, len(content), len(content) // 60):
        path.write_bytes(content[:size])
        try:
            with SortedFile(path) as file:
                file.select([(None, 0, 1)])
        except UnusualLayoutError:
            refused += 1
    assert refused == len(range(0, len(content), len(content) // 60))
