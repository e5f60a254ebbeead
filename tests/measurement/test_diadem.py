"""DIAdem headers: storage of values, types, implicit channels, texts, damage."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies, refusals

GLOBAL = "DIAEXTENDED  {@:ENGLISH\n#BEGINGLOBALHEADER\n  1,WINDOWS 32Bit\n111,9.900000e+034\n112,High -> Low\n"


def channel(name, unit="", comment="", **entries):
    lines = [f"200,{name}", f"201,{comment}", f"202,{unit}"]
    lines += [f"{key.removeprefix('_')},{value}" for key, value in entries.items()]
    return "#BEGINCHANNELHEADER\n" + "\n".join(lines) + "\n#ENDCHANNELHEADER\n\n"


def explicit(name, file, kind, count, first=1, method="CHANNEL", **entries):
    more = {"_210": "EXPLICIT", "_211": file, "_213": method, "_214": kind, "_220": count, "_221": first}
    unit = entries.pop("unit", "")
    return channel(name, unit, **more, **entries)


def implicit(name, unit, count, start, step):
    return channel(name, unit, _210="IMPLICIT", _220=count, _240=start, _241=step)


@pytest.fixture
def diadem(tmp_path):
    """Writes a header with these channels, and files beside it."""

    def write(*channels, common=GLOBAL, **files):
        for name, values in files.items():
            (tmp_path / name.replace("_", ".")).write_bytes(values if isinstance(values, bytes) else values.tobytes())
        path = tmp_path / "bench.dat"
        path.write_text(common + "#ENDGLOBALHEADER\n\n" + "".join(channels), encoding="latin-1")
        return path

    return write


def test_channels_one_after_the_other_are_read(diadem):
    path = diadem(
        implicit("Time", "s", 3, 0.5, 0.1),
        explicit("Speed", "bench.r64", "REAL64", 3, unit="rpm"),
        explicit("Torque", "C:\\old\\BENCH.R64", "REAL64", 3, first=4, unit="[Nm]"),
        explicit("Raw", "bench.i16", "INT16", 3, _240=10.0, _241=0.5),
        bench_r64=np.array([900.0, 9.9e34, 1000.0, 1.0, 2.0, 3.0]),
        bench_i16=np.array([2, 4, 6], dtype="<i2"),
    )
    data = read(path)
    np.testing.assert_allclose(data.time, [0.5, 0.6, 0.7])
    np.testing.assert_array_equal(data["Speed"].values, [900.0, np.nan, 1000.0])
    assert (data["Torque"].values.tolist(), data["Torque"].unit) == ([1.0, 2.0, 3.0], "Nm")
    assert data["Raw"].values.tolist() == [11.0, 12.0, 13.0]
    assert describe(path).kind == "DIAdem"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8", "cp1252"])
def test_headers_are_read_in_any_encoding(diadem, encoding):
    path = diadem(explicit("Öl", "bench.r64", "REAL64", 3, unit="°C"), bench_r64=np.arange(3.0))
    path.write_text(path.read_text("latin-1"), encoding=encoding)
    assert describe(path).kind == "DIAdem"
    assert read(path)["Öl"].unit == "°C"


def test_german_keywords_and_records_without_places_are_read(diadem):
    path = diadem(
        channel("T", "[s]", _210="IMPLIZIT", _220=3, _240=10, _241="5E-03"),
        channel("UD", _210="EXPLIZIT", _211="S1.I32", _213="BLOCK", _214="INT32", _220=3),
        channel("NS", _210="EXPLIZIT", _211="S1.I32", _213="BLOCK", _214="INT32", _220=3),
        S1_I32=np.array([[1, 10], [2, 20], [3, 30]], dtype="<i4"),
    )
    data = read(path)
    np.testing.assert_allclose(data.time, [10.0, 10.005, 10.01])
    assert (data["UD"].values.tolist(), data["NS"].values.tolist()) == ([1.0, 2.0, 3.0], [10.0, 20.0, 30.0])


def test_columns_of_text_without_places_follow_each_other(diadem):
    more = {"_213": "BLOCK", "_214": "ASCII", "_220": 2, "_230": ";", "_210": "EXPLICIT", "_211": "bench.asc"}
    path = diadem(channel("a", **more), channel("b", **more), bench_asc=b"1;3\n2;4\n")
    data = read(path)
    assert (data["a"].values.tolist(), data["b"].values.tolist()) == ([1.0, 2.0], [3.0, 4.0])


def test_a_channel_may_have_its_own_number_for_missing_values(diadem):
    path = diadem(
        explicit("a", "bench.r64", "REAL64", 3, _254=-1),
        explicit("b", "bench.r64", "REAL64", 3),
        bench_r64=np.array([1.0, -1.0, 9.9e34]),
    )
    data = read(path)
    np.testing.assert_array_equal(data["a"].values, [1.0, np.nan, 9.9e34])
    np.testing.assert_array_equal(data["b"].values, [1.0, -1.0, np.nan])


@pytest.mark.parametrize("stated", [True, False])
def test_blocks_have_a_record_for_each_sample(diadem, stated):
    more = {"_222": 2} if stated else {}
    path = diadem(
        explicit("a", "bench.r32", "REAL32", 3, first=1, method="BLOCK", _241=0.0, **more),
        explicit("b", "bench.r32", "REAL32", 3, first=2, method="BLOCK", _241=0.0, **more),
        bench_r32=np.array([1, 10, 2, 20, 3, 30], dtype="<f4"),
    )
    data = read(path)
    assert data["a"].values.tolist() == [1.0, 2.0, 3.0]
    assert data["b"].values.tolist() == [10.0, 20.0, 30.0]


def test_bytes_may_be_in_the_other_order(diadem):
    path = diadem(
        explicit("a", "bench.r64", "REAL64", 2),
        common=GLOBAL.replace("High -> Low", "Low -> High"),
        bench_r64=np.array([1.0, 2.0], dtype=">f8"),
    )
    assert read(path)["a"].values.tolist() == [1.0, 2.0]


def test_texts_are_read(diadem):
    path = diadem(
        explicit("a", "bench.asc", "ASCII", 2, first=2, method="BLOCK", _223=1, _230=";", _231=","),
        explicit("b", "bench.asc", "ASCII", 2, first=2, method="BLOCK", _223=2, _230=";", _231=","),
        bench_asc=b"a;b\n1,5;3\n2,5;4\n",
    )
    data = read(path)
    assert (data["a"].values.tolist(), data["b"].values.tolist()) == ([1.5, 2.5], [3.0, 4.0])


def test_lengths_are_rasters(diadem):
    path = diadem(
        implicit("t fast", "s", 4, 0.0, 0.1),
        explicit("Speed", "bench.r64", "REAL64", 4),
        implicit("t slow", "s", 2, 0.0, 0.3),
        explicit("Temperature", "bench.r64", "REAL64", 2),
        bench_r64=np.arange(4.0),
    )
    assert [table.samples for table in describe(path).tables] == [4, 2]
    assert read(path, ["Temperature"]).time.tolist() == [0.0, 0.3]


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"file": "other.r64"}, "file other.r64 is not beside the header"),
        ({"kind": "TWOC12"}, "values of type TWOC12 cannot be read"),
        ({"count": 9}, r"file bench.r64 is cut off: it has only 24 bytes"),
        ({"count": "many"}, "entry 220 is 'many', not a whole number"),
        ({"first": 0}, "an impossible place"),
        ({"count": 10**12}, "it claims 1000000000000 values"),
    ],
)
def test_errors_of_a_header_are_reported_with_the_channel(diadem, entries, message):
    stated = {"file": "bench.r64", "kind": "REAL64", "count": 3} | entries
    path = diadem(explicit("Speed", **stated), bench_r64=np.arange(3.0))
    with pytest.raises(InputError, match=f"bench.dat channel Speed: .*{message}"):
        read(path)


def test_a_channel_that_cannot_be_read_is_left_out_with_a_warning(diadem):
    path = diadem(
        explicit("Speed", "bench.r64", "REAL64", 3),
        explicit("Torque", "other.r64", "REAL64", 3),
        bench_r64=np.arange(3.0),
    )
    data = read(path)
    assert list(data) == ["Speed"]
    assert [finding.severity for finding in data.findings] == ["warning"]
    assert "channel Torque: file other.r64 is not beside the header" in str(data.findings[0])
    assert list(read(path, ["Speed"])) == ["Speed"]
    with pytest.raises(InputError, match=r"file other\.r64 is not beside the header"):
        read(path, ["Torque"])


@pytest.mark.parametrize(
    ("file", "problem"), [("other.r64", "is not beside the header"), ("bench.r64", "is cut off: it has only 24 bytes")]
)
def test_channels_of_one_unreadable_file_share_a_message(diadem, file, problem):
    names = ["Speed", "Torque", "Load", "Lambda", "Spark", "NOx", "CO"]
    path = diadem(
        *(explicit(name, file, "REAL64", 3, first=4 + 3 * place) for place, name in enumerate(names)),
        bench_r64=np.arange(3.0),
    )
    message = f"channels Speed, Torque, Load, Lambda, Spark and 2 more: file {file} {problem}"
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    assert len(caught.value.findings) == 1


@few_or_many_copies
def test_damaged_headers_are_read_or_refused(diadem, count):
    path = diadem(
        implicit("Time", "s", 3, 0.5, 0.1),
        explicit("Speed", "bench.r64", "REAL64", 3, unit="rpm"),
        explicit("Torque", "bench.r64", "REAL64", 3, first=4, method="BLOCK", _222=1),
        bench_r64=np.arange(6.0),
    )
    assert refusals(path, head=20, count=count, bytes_=b"0123456789,#\nA-. ", raster=0.1) > count / 6
