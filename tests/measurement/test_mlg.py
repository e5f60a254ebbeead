"""MLG logs: scaling, bits, markers, time, checksums, and files that lie about themselves."""

import contextlib
import random
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.draws import few_or_many
from tests.measurement.mlg_files import SIZES, bits, mark, mlg, number, record
from tests.measurement.mutants import few_or_many_copies

TIME = number("Time", unit="s", digits=3)
RPM = number("RPM", 2, "rpm")


def rows(fields, *values):
    return [record(fields, row, 10 * k) for k, row in enumerate(values)]


def details(path):
    return describe(path).tables[0].details


@pytest.fixture
def log(csv):
    """Writes the bytes of a log."""
    return lambda content: csv(content, "run.mlg")


@pytest.mark.parametrize("version", [1, 2])
def test_raw_numbers_are_shifted_and_scaled(log, version):
    fields = [TIME, RPM, number("AFR", 0, "O2", scale=0.1, digits=1), number("CLT", 1, "°C", scale=0.5, transform=-40)]
    data = read(log(mlg(fields, rows(fields, (0.0, 800, 147, 120), (0.5, 65000, 100, -128)), version)))
    assert data["RPM"].values.tolist() == [800, 65000]
    np.testing.assert_allclose(data["AFR"].values, [14.7, 10.0], rtol=1e-15)  # the scale is 0.1, not its float32
    assert data["CLT"].values.tolist() == [40, -84]
    assert [c.unit for c in data.values()] == ["rpm", "O2", "°C"]
    assert data.time.tolist() == [0.0, 0.5]


@few_or_many(st.sampled_from(sorted(SIZES)[:8]), st.data(), few=20, many=100)
def test_every_type_of_number_keeps_its_values(tmp_path_factory, kind, data):
    width = struct.calcsize(SIZES[kind])
    if kind == 7:
        values = st.floats(width=32, allow_nan=False, allow_infinity=False)
    else:
        low = 0 if SIZES[kind].isupper() else -(2 ** (8 * width - 1))
        values = st.integers(low, low + 2 ** (8 * width) - 1)
    drawn = data.draw(st.lists(values, min_size=2, max_size=9))
    fields = [TIME, number("x", kind)]
    path = tmp_path_factory.mktemp("mlg") / "run.mlg"
    path.write_bytes(mlg(fields, rows(fields, *enumerate(drawn))))
    np.testing.assert_array_equal(read(path)["x"].values, np.array(drawn, dtype=np.float64))


@pytest.mark.parametrize("kind", [10, 16, 11, 17])
def test_bits_are_channels_of_their_own(log, kind):
    fields = [TIME, bits("Engine", "running", "cranking", "", kind=kind), bits("", "Fan", "Pump", kind=kind)]
    path = log(mlg(fields, rows(fields, (0.0, 0b101, 0b10), (1.0, 0b010, 0b11)), 2))
    data = read(path)
    assert {name: c.values.tolist() for name, c in data.items()} == {
        "Engine": [5, 2],
        "running": [1, 0],
        "cranking": [0, 1],
        "Engine bit 2": [1, 0],
        "Fan": [0, 1],
        "Pump": [1, 1],
    }
    assert read(path, ["Fan"], raster=0.25)["Fan"].values.tolist() == [0, 0, 0, 0, 1]


def test_bits_without_names_have_a_number(log):
    fields = [TIME, bits("", count=2)]
    data = read(log(mlg(fields, rows(fields, (0.0, 2), (1.0, 1)))))
    assert {name: c.values.tolist() for name, c in data.items()} == {
        "field 2 bit 0": [0, 1],
        "field 2 bit 1": [1, 0],
    }


def test_fields_called_the_same_are_kept_apart(log):
    fields = [TIME, RPM, RPM]
    data = read(log(mlg(fields, rows(fields, (0.0, 1, 2), (1.0, 3, 4)))))
    assert data["RPM (2)"].values.tolist() == [2, 4]


def test_a_switch_is_held_and_categories_and_digits_are_described(log):
    fields = [TIME, number("Fan", 0, style=4), number("AFR", 0, scale=0.1, digits=1, category="Fuel")]
    path = log(mlg(fields, rows(fields, (0.0, 0, 100), (1.0, 1, 200)), 2))
    assert read(path, raster=0.5)["Fan"].values.tolist() == [0, 0, 1]
    assert read(path, raster=0.5)["AFR"].values.tolist() == [10, 15, 20]
    assert describe(path).tables[0].channels[2].description == "Fuel, 1 digit"


def test_markers_are_reported_and_do_not_disturb(log):
    fields = [TIME, RPM]
    values = [(0.1 * k, k) for k in range(300)]
    blocks = rows(fields, *values)
    path = log(mlg(fields, [mark("start"), *blocks[:200], mark("MARK 000 - Manual"), mark("again"), *blocks[200:]]))
    assert read(path)["RPM"].values.tolist() == list(range(300))
    assert details(path)["markers"] == "3 (start at 0 s; MARK 000 - Manual at 20 s; again at 20 s)"


def test_a_log_without_a_time_unwraps_the_stamps_of_its_records(log):
    fields = [RPM]
    blocks = [record(fields, (k,), (40_000 * k) % 65_536) for k in range(5)]
    path = log(mlg(fields, blocks))
    np.testing.assert_allclose(read(path).time, [0.0, 0.4, 0.8, 1.2, 1.6])
    assert read(path, ["RPM"]).samples == 5
    assert details(path)["time"] == "from the stamps of the records, without pauses longer than 0.65 s"


def test_a_time_that_stands_still_throughout_is_none(log):
    fields = [TIME, RPM]
    blocks = [record(fields, (0.0, k), 1000 * k) for k in range(3)]
    np.testing.assert_allclose(read(log(mlg(fields, blocks))).time, [0.0, 0.01, 0.02])


def test_a_field_of_milliseconds_is_time_too(log):
    fields = [number("Time", 4, "ms"), RPM]
    assert read(log(mlg(fields, rows(fields, (0, 1), (20, 2))))).time.tolist() == [0.0, 0.02]


@pytest.mark.parametrize("first", [(np.nan,), (np.inf,), (900.0,), (np.nan, np.nan), (np.nan, 900.0)])
def test_first_records_without_a_time_stamp_are_left_out_with_a_remark(log, first):
    fields = [TIME, RPM]
    values = [*((time, 7) for time in first), *((0.1 * k, 800 + k) for k in range(40))]
    path = log(mlg(fields, rows(fields, *values)))
    data = read(path)
    assert data["RPM"].values.tolist() == [800 + k for k in range(40)]
    assert data.piece_starts.tolist() == [0]
    remark = data.findings[-1]
    assert remark.severity == "remark"
    assert str(remark).startswith(f"run.mlg record 1: {len(first)} record")
    assert "skipped: without a time stamp or later than the next one" in remark.message
    assert describe(path).tables[0].samples == 40


def test_records_without_a_time_stamp_in_between_are_left_out(log):
    fields = [TIME, RPM]
    path = log(mlg(fields, rows(fields, (0.0, 1), (np.nan, 2), (0.2, 3), (np.nan, 4), (0.4, 5))))
    data = read(path)
    assert data.time.tolist() == pytest.approx([0, 0.2, 0.4])
    assert (data.findings[0].severity, str(data.findings[0].location)) == ("warning", "run.mlg record 2")


def test_a_restart_after_more_than_one_record_is_a_piece(log):
    fields = [TIME, RPM]
    data = read(log(mlg(fields, rows(fields, (5.0, 1), (5.1, 2), (0.0, 3), (0.1, 4)))))
    assert data.piece_starts.tolist() == [0, 2]
    assert data.findings == ()


def test_infinite_numbers_are_missing(log):
    fields = [TIME, number("x")]
    values = read(log(mlg(fields, rows(fields, (0.0, np.inf), (1.0, np.nan), (2.0, 3.0)))))["x"].values
    assert np.isnan(values[:2]).all()
    assert values[2] == 3


def test_records_with_a_wrong_checksum_are_skipped_and_reported(log):
    fields = [TIME, RPM]
    blocks = [record(fields, (k, k), wrong_sum=k == 2) for k in range(5)]
    path = log(mlg(fields, blocks))
    assert read(path)["RPM"].values.tolist() == [0, 1, 3, 4]
    assert details(path)["left out"] == "1 record with a wrong checksum"


def test_a_logger_that_writes_no_checksums_is_believed(log):
    fields = [TIME, RPM]
    path = log(mlg(fields, [record(fields, (k, k), wrong_sum=True) for k in range(5)]))
    assert read(path).samples == 5


def test_a_log_that_ends_within_a_record_keeps_the_whole_ones(log):
    fields = [TIME, RPM]
    path = log(mlg(fields, rows(fields, (0.0, 1), (1.0, 2), (2.0, 3)))[:-4])
    assert read(path)["RPM"].values.tolist() == [1, 2]
    assert details(path)["cut off"] == "the last record lacks its end (7 bytes are there)"


def test_time_that_starts_anew_begins_a_piece(log):
    fields = [TIME, RPM]
    path = log(mlg(fields, rows(fields, (5.0, 0), (6.0, 10), (0.0, 3), (1.0, 4), (2.0, 5))))
    data = read(path)
    assert data.piece_starts.tolist() == [0, 2]
    assert data.time.tolist() == [5, 6, 0, 1, 2]
    assert details(path)["pieces"] == "2, since its time restarts"
    even = read(path, ["RPM"], raster=0.5)
    assert even.piece_starts.tolist() == [0, 3]
    assert even["RPM"].values.tolist() == [0, 5, 10, 3, 3.5, 4, 4.5, 5]


def test_the_information_of_the_log_is_described(log):
    info = '"speeduino 202207: Speeduino 202207.1"\n"Capture Date"\n\nNEW_INFO_PROVIDER,LogStart_MAIN_TUNE,\n<msq/>'
    information = details(log(mlg([TIME, RPM], rows([TIME, RPM], (0.0, 1), (1.0, 2)), 2, info, created=1_600_000_000)))
    assert information == {
        "version": "2",
        "recorded": "2020-09-13 12:26 UTC",
        "by": "speeduino 202207: Speeduino 202207.1",
        "tune": "a whole TunerStudio tune (.msq) is inside",
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 3}, "is of version 3, which is not supported"),
        ({"length": 9}, "its records are of 9 bytes, their fields of 6"),
        ({"count": 65535}, "its head alone needs"),
        ({"count": 0}, "names 0 fields"),
    ],
)
def test_a_wrong_head_is_a_finding(log, change, message):
    fields = {"version": 1} | change
    content = mlg([TIME, RPM], rows([TIME, RPM], (0.0, 1)), **{**fields, "version": 1})
    content = content[:6] + struct.pack(">h", fields["version"]) + content[8:]
    with pytest.raises(InputError, match=message):
        read(log(content))


def test_all_wrong_fields_are_named(log):
    fields = [TIME, number("a", 99), number("b", 7, scale=np.inf)]
    with pytest.raises(InputError) as caught:
        read(log(mlg(fields, [])))
    assert [str(f).partition(".")[0] + f.message for f in caught.value.findings] == [
        "rununknown type 99",
        "runits scale inf and transform 0 must be finite",
    ]
    assert [str(f.location) for f in caught.value.findings] == ["run.mlg field 2", "run.mlg field 3"]


def test_an_unknown_block_and_a_log_without_records_are_findings(log):
    fields = [TIME, RPM]
    with pytest.raises(InputError, match=r"after 2 records, at byte .*, there is a block of unknown type 7"):
        read(log(mlg(fields, [*rows(fields, (0.0, 1), (1.0, 2)), b"\7\0\0\0"])))
    with pytest.raises(InputError, match="holds no records"):
        read(log(mlg(fields, [mark("nothing")])))


def test_a_head_that_claims_much_costs_no_memory(log):
    fields = [TIME, RPM]
    content = bytearray(mlg(fields, rows(fields, (0.0, 1), (1.0, 2)), 2))
    for at in (12, 16):
        blown = bytes(content[:at]) + struct.pack(">I", 2**31 - 1) + bytes(content[at + 4 :])
        tracemalloc.start()
        with contextlib.suppress(InputError):
            read(log(blown))
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
        tracemalloc.stop()


@few_or_many_copies
def test_mutated_logs_give_data_or_findings(log, count):
    chance = random.Random(20)
    fields = [TIME, RPM, bits("Engine", "a", "b", kind=16), number("AFR", 0, scale=0.1)]
    blocks = rows(fields, *((0.1 * k, k, k % 4, k) for k in range(40)))
    content = mlg(fields, [*blocks[:20], mark("here"), *blocks[20:]], 2, '"by"\n')
    for _ in range(count):
        changed = bytearray(content)
        for _ in range(chance.randint(1, 4)):
            at = chance.randrange(8, len(changed)) if chance.random() < 0.5 else chance.randrange(8, 400)
            changed[at] = chance.choice([0, 1, 16, 255, chance.randrange(256)])
        if chance.random() < 0.3:
            del changed[chance.randrange(8, len(changed)) :]
        path = log(bytes(changed))
        with contextlib.suppress(InputError):
            assert read(path).samples
            describe(path)


@few_or_many(st.lists(st.booleans(), max_size=200), few=10, many=30)
def test_markers_anywhere_leave_the_records_in_order(log, markers):
    fields = [TIME, RPM]
    records = iter(rows(fields, *((k, k) for k in range(len(markers) + 1))))
    blocks = [mark(f"m{k}") if marked else next(records) for k, marked in enumerate(markers)]
    path = log(mlg(fields, [*blocks, next(records)]))
    count = markers.count(False) + 1
    assert read(path)["RPM"].values.tolist() == list(range(count))


def test_real_logs_are_read(real):
    data = read(real("ecu_logs/mlgconverter_long.mlg"))
    assert data.samples == 27_616  # two of them have one time stamp, and other values
    assert len(data) == 66
    assert data.time[-1] == pytest.approx(3130.063, abs=1e-3)  # 52 minutes; its stamps lost 1189 s in pauses
    assert 10 < np.median(data["AFR"].values) < 20
    assert details(real("ecu_logs/mlgconverter_long.mlg"))["markers"].startswith("24 (MARK 000 - Going Offline")
    tuned = real("ecu_logs/mlgconverter_v2.mlg")
    assert {"Engine Prot. RPM", "Engine Prot. CLT"} <= set(read(tuned))
    assert "tune" in details(tuned)
