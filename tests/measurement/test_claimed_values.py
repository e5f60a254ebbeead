"""Files that claim more values than their size allows are refused, whatever their format."""

import zipfile

import pytest

from kennfeld.base.errors import InputError
from kennfeld.base.process_limits import memory_bound
from kennfeld.measurement import read
from kennfeld.measurement.claimed_values import check_claimed
from kennfeld.measurement.source import locate
from tests.measurement import test_diadem as dat

CLAIMED = 90_000_000  # values, 720 MB


def refused(path):
    return pytest.raises(InputError, match=rf"^{path.name}: the file is damaged: it claims \d+ values in [\d.e-]+ MB")


def test_the_bound_follows_the_size(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n1,2\n", encoding="utf-8")
    most = memory_bound(10**6) // 8
    check_claimed(locate(path), most, 10**6)
    with refused(path):
        check_claimed(locate(path), most + 1, 10**6)


def test_evenly_spaced_values_without_a_file_of_values(tmp_path):
    path = tmp_path / "run.dat"
    header = dat.GLOBAL + "#ENDGLOBALHEADER\n\n" + dat.implicit("Time", "s", CLAIMED, 0.0, 0.1)
    path.write_text(header, encoding="cp1252")
    with refused(path):
        read(path)


def test_a_dataset_that_was_never_written(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("Speed", (CLAIMED,), "f8", chunks=True)
    with pytest.raises(InputError, match="far more numbers than its size allows"):
        read(path)


def test_a_stray_cell_of_a_small_workbook(tmp_path):
    xlsxwriter = pytest.importorskip("xlsxwriter")
    near, path = tmp_path / "near.xlsx", tmp_path / "run.xlsx"
    with xlsxwriter.Workbook(str(near)) as book:
        book.add_worksheet().write_column(0, 0, ["Speed", 1.0, 2.0])
    with zipfile.ZipFile(near) as before, zipfile.ZipFile(path, "w") as after:
        for name in before.namelist():
            content = before.read(name)
            after.writestr(name, content.replace(b'r="A3"', b'r="AE1000000"').replace(b'r="3"', b'r="1000000"'))
    with pytest.raises(InputError, match="Delete the stray cells far from the table"):
        read(path)
