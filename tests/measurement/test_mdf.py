"""MDF 3 and 4: groups of several rasters, enumerations, arrays, names that collide, and damage."""

import contextlib
import gc
import random
import struct
import sys
import tempfile
import warnings

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from kennfeld.measurement.mdf import describe_by_library
from kennfeld.measurement.source import locate

FILES = [
    "asammdf_ASAP2_Demo_V171.mf4",
    "asammdf_test_batch.mf4",
    "asammdf_test_metadata.mf4",
]
TEXTS = {"val_0": 0, "text_0": "off", "val_1": 1, "text_1": "on", "val_2": 2, "text_2": "fault"}


def signal(name, time, values, unit="", **more):
    from asammdf import Signal

    return Signal(np.asarray(values), np.asarray(time, dtype=float), name=name, unit=unit, **more)


@pytest.fixture
def mdf(tmp_path):
    """Writes groups of signals as an MDF file: (name of the group, signals)."""

    def write(*groups, version="4.10", compression=0, name=None, **more):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from asammdf import MDF

            with MDF(version=version) as file:
                for label, signals in groups:
                    index = file.append(signals, comment=label, common_timebase=True, **more)
                    if version >= "4":
                        file.groups[index].channel_group.acq_name = label
                return file.save(
                    tmp_path / (name or f"bench.{'mf4' if version >= '4' else 'mdf'}"),
                    compression=compression,
                    overwrite=True,
                )

    return write


def fast_and_slow():
    fast, slow = np.arange(0, 2.005, 0.01), np.arange(0.5, 1.8, 0.1)
    return (
        ("10ms", [signal("Speed", fast, 1000 + 100 * fast, "rpm")]),
        ("100ms", [signal("Temp", slow, 20 + slow, "degC"), signal("Gear", slow, (slow * 10).astype(np.uint8))]),
    )


@pytest.mark.parametrize("version", ["2.14", "3.00", "3.30", "4.00", "4.11", "4.20"])
@pytest.mark.parametrize("compression", [0, 1, 2])
def test_every_version_gives_the_same_numbers(mdf, version, compression):
    if version < "4" and compression:
        pytest.skip("only version 4 compresses")
    path = mdf(*fast_and_slow(), version=version, compression=compression)
    data = read(path, ["Speed"])
    assert data["Speed"].unit == "rpm"
    np.testing.assert_allclose(data.time, np.arange(0, 2.005, 0.01), atol=1e-12)
    np.testing.assert_allclose(data["Speed"].values, 1000 + 100 * data.time, rtol=1e-14)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_rasters_meet_over_the_time_they_share(mdf, version):
    data = read(mdf(*fast_and_slow(), version=version), ["Temp", "Speed", "Gear"], raster=0.05)
    assert (data.time[0], round(data.time[-1], 9)) == (0.5, 1.7)
    np.testing.assert_allclose(np.diff(data.time), 0.05)
    np.testing.assert_allclose(data["Speed"].values, 1000 + 100 * data.time)
    np.testing.assert_allclose(data["Temp"].values, 20 + data.time)


def test_integers_are_held_and_floats_interpolated(mdf):
    fast, slow = np.arange(0, 4.1, 0.25), np.arange(5.0)
    path = mdf(
        ("fast", [signal("Speed", fast, fast)]),
        ("slow", [signal("Count", slow, np.array([0, 10, 20, 30, 40], np.int16)), signal("Level", slow, slow / 3)]),
    )
    data = read(path, raster=0.25)
    np.testing.assert_array_equal(data["Count"].values, 10 * np.floor(data.time))
    np.testing.assert_allclose(data["Level"].values, data.time / 3)


def test_scaled_integers_are_physical_and_interpolated(mdf):
    fast, slow = np.arange(0, 4.1, 0.25), np.arange(5.0)
    raw = signal("Torque", slow, np.array([0, 10, 20, 30, 40], np.int16), "Nm", conversion={"a": 0.5, "b": -3.0})
    data = read(mdf(("fast", [signal("Speed", fast, fast)]), ("slow", [raw])), raster=0.25)
    np.testing.assert_allclose(data["Torque"].values, 5 * data.time - 3)


def test_different_rasters_without_one_to_read_on_are_a_finding(mdf):
    with pytest.raises(InputError) as caught:
        read(mdf(*fast_and_slow()), ["Speed", "Temp"])
    (finding,) = caught.value.findings
    assert "Speed every 0.01 s from 0 s, Temp every 0.1 s from 0.5 s" in finding.message
    assert "raster = 0.01" in finding.remedy


def test_channels_of_one_group_or_equal_stamps_need_no_raster(mdf):
    time = np.arange(10) * 0.1
    path = mdf(("a", [signal("Speed", time, time)]), ("b", [signal("Torque", time, -time)]))
    assert list(read(path)) == ["Speed", "Torque"]
    assert list(read(mdf(*fast_and_slow()), ["Gear", "Temp"])) == ["Gear", "Temp"]


def test_groups_that_share_no_time_are_a_finding(mdf):
    early, late = np.arange(5.0), 10 + np.arange(5.0)
    path = mdf(("a", [signal("Speed", early, early)]), ("b", [signal("Torque", late, late)]))
    with pytest.raises(InputError, match=r"do not overlap: Speed from 0 s to 4 s, Torque from 10 s to 14 s"):
        read(path, raster=1.0)


def test_a_pause_becomes_nan(mdf):
    time = np.concatenate([np.arange(0, 1, 0.01), np.arange(3, 4, 0.01)])
    other = np.arange(0, 4, 0.01)
    path = mdf(("a", [signal("Torque", time, 2 * time + 0.5)]), ("b", [signal("Speed", other, other)]))
    data = read(path, raster=0.01)
    inside = (data.time > 1.0) & (data.time < 2.99)
    assert np.isnan(data["Torque"].values[inside]).all()
    assert not np.isnan(data["Torque"].values[data.time < 0.98]).any()
    assert not np.isnan(data["Speed"].values).any()


def test_near_duplicate_stamps_are_one_sample(mdf):
    time = np.array([0, 1, 1 + 2e-10, 2, 3])
    data = read(mdf(("a", [signal("Speed", time, [1.0, 2.0, 2.5, 3.0, 4.0])])))
    assert data.time.tolist() == [0, 1, 2, 3]
    assert data["Speed"].values.tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_an_enumeration_keeps_its_numbers_and_describes_its_texts(mdf, version):
    time = np.arange(6.0)
    states = np.array([0, 1, 2, 1, 0, 7], np.uint8)
    path = mdf(("a", [signal("State", time, states, conversion=dict(TEXTS))]), version=version)
    channel = read(path)["State"]
    np.testing.assert_array_equal(channel.values, states)
    assert channel.description == "0 = off, 1 = on, 2 = fault"
    assert describe(path).tables[0].channels[1].description == channel.description


def test_elements_of_arrays_are_channels(mdf):
    time = np.arange(4.0)
    values = np.arange(24, dtype=float).reshape(4, 2, 3)
    record = np.rec.fromarrays([values], dtype=np.dtype([("Map", "<f8", (2, 3))]))
    path = mdf(("a", [signal("Map", time, record), signal("Speed", time, time)]))
    data = read(path)
    assert list(data) == [*(f"Map[{i}][{j}]" for i in range(2) for j in range(3)), "Speed"]
    np.testing.assert_array_equal(data["Map[1][2]"].values, values[:, 1, 2])
    assert list(read(path, ["Map[0][1]"])) == ["Map[0][1]"]
    assert [c.name for c in describe(path).tables[0].channels] == ["time", *data]
    with pytest.raises(InputError, match=r"no channel Map\[2\]\[0\]"):
        read(path, ["Map[2][0]"])


def test_arrays_of_scaled_integers_are_physical(mdf):
    values = np.arange(12, dtype=np.int16).reshape(4, 3)
    record = np.rec.fromarrays([values], dtype=np.dtype([("Curve", "<i2", (3,))]))
    path = mdf(("a", [signal("Curve", np.arange(4.0), record, "Nm", conversion={"a": 0.5, "b": -3.0})]))
    data = read(path)
    assert [(c.name, c.unit) for c in data.values()] == [(f"Curve[{i}]", "Nm") for i in range(3)]
    np.testing.assert_array_equal(data["Curve[2]"].values, 0.5 * values[:, 2] - 3)


def test_names_of_several_groups_are_distinguished(mdf):
    fast, slow = np.arange(0, 2, 0.01), np.arange(0, 2, 0.1)
    path = mdf(("10ms", [signal("Speed", fast, fast)]), ("100ms", [signal("Speed", slow, -slow)]))
    assert list(read(path, raster=0.1)) == ["10ms/Speed", "100ms/Speed"]
    assert read(path, ["100ms/Speed"])["100ms/Speed"].values[-1] == pytest.approx(-1.9)
    with pytest.raises(InputError) as caught:
        read(path, ["Speed"])
    assert str(caught.value).endswith("2 channels are named Speed. Name one of them: 10ms/Speed, 100ms/Speed.")
    assert describe(path).tables[0].ambiguous == ("Speed",)


def test_a_name_with_its_group_is_understood_where_the_short_one_would_do(mdf):
    data = read(mdf(*fast_and_slow()), ["10ms/Speed", "100ms/Temp"], raster=0.1)
    assert list(data) == ["10ms/Speed", "100ms/Temp"]


def test_the_device_behind_a_backslash_may_be_left_out(mdf):
    time = np.arange(5.0)
    path = mdf(("a", [signal(n, time, time + k) for k, n in enumerate(["Speed\\ETKC:1", "T\\ETKC:1", "T\\CAN:1"])]))
    assert list(read(path)) == ["Speed", "T\\ETKC:1", "T\\CAN:1"]
    assert read(path, ["Speed\\ETKC:1"])["Speed\\ETKC:1"].values[0] == 0
    with pytest.raises(InputError, match="2 channels are named T"):
        read(path, ["T"])


def test_groups_of_one_name_are_distinguished_by_their_number(mdf):
    time = np.arange(5.0)
    path = mdf(*((("CAN", [signal("Speed", time, k * time)])) for k in (1, 2)))
    first, second = read(path).values()
    assert (first.name, second.name) == ("1.1/Speed", "2.1/Speed")
    assert (first.values[1], second.values[1]) == (1, 2)


def test_a_channel_called_time_is_not_the_clock(mdf):
    stamps = np.arange(5.0)
    path = mdf(("10ms", [signal("time", stamps, stamps**2), signal("Speed", stamps, stamps)]))
    data = read(path)
    assert list(data) == ["10ms/time", "Speed"]
    assert data.time.tolist() == stamps.tolist()
    assert read(path, ["Speed", "time"])["time"].values.tolist() == stamps.tolist()


def test_missing_and_text_channels_are_findings(mdf):
    time = np.arange(3.0)
    texts = signal("Note", time, np.array([b"cold", b"warm", b"hot"]), encoding="utf-8")
    path = mdf(("a", [signal("Speed", time, time), texts]))
    with pytest.raises(InputError) as caught:
        read(path, ["Speeed", "Speed"])
    assert str(caught.value) == "bench.mf4: has no channel Speeed. Did you mean Speed?"
    with pytest.raises(InputError, match="the column holds text, such as "):
        read(path, ["Note"])
    assert list(read(path)) == ["Speed"]
    assert describe(path).tables[0].left_out == ("Note",)


def test_without_the_library_files_of_plain_layout_are_read_and_others_name_its_command(mdf, monkeypatch):
    time = np.arange(3.0)
    channels = [signal("Speed", time, time)]
    plain, old = mdf(("a", channels), name="plain.mf4"), mdf(("a", channels), version="2.14", name="old.mdf")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    assert read(plain)["Speed"].values.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(
        InputError, match=r'^old\.mdf: the package asammdf is not installed\. Run: pip install "kennfeld\[mdf\]"$'
    ):
        read(old)


def test_a_channel_of_varying_length_is_left_out(mdf):
    time = np.arange(3.0)
    texts = signal("Log", time, np.array([b"a", b"a longer text", b""]), encoding="utf-8")
    path = mdf(("a", [signal("Speed", time, time)]), ("b", [texts]), version="4.20")
    assert [table.left_out for table in describe(path).tables] == [(), ("Log",)]
    with pytest.raises(InputError, match="column Log: the column holds text"):
        read(path, ["Log", "Speed"], raster=1.0)


def test_invalid_and_infinite_samples_are_missing(mdf):
    time = np.arange(4.0)
    marked = signal("Speed", time, time, invalidation_bits=np.array([False, True, False, False]))
    path = mdf(("a", [marked, signal("Torque", time, [1.0, 2.0, np.inf, -np.inf])]))
    data = read(path)
    np.testing.assert_array_equal(data["Speed"].values, [0, np.nan, 2, 3])
    np.testing.assert_array_equal(data["Torque"].values, [1, 2, np.nan, np.nan])
    assert describe(path).tables[0].channels[1].nan_share == 0.25


def test_time_that_falls_is_a_finding(mdf):
    time = np.array([0.0, 1.0, 0.5, 2.0])
    with pytest.raises(InputError, match=r"sample 3, column time: time goes backwards, from 1 s to 0.5 s"):
        read(mdf(("a", [signal("Speed", time, time)])))


def test_the_description_has_units_ranges_and_rates(mdf):
    tables = describe(mdf(*fast_and_slow())).tables
    assert [table.name for table in tables] == ["10ms", "100ms"]
    assert [table.samples for table in tables] == [201, 13]
    assert tables[1].time.step == pytest.approx(0.1)
    assert tables[1].time.begin == 0.5
    temp = tables[1].channels[1]
    assert (temp.name, temp.unit, temp.minimum, temp.maximum) == ("Temp", "degC", 20.5, pytest.approx(21.7))


def test_a_long_description_is_built_in_parts(mdf, tmp_path, monkeypatch):
    time = np.arange(10.0)
    path = mdf(("a", [signal(f"c{k}", time, time + k) for k in range(7)]))
    whole = describe(path)
    monkeypatch.setattr("kennfeld.measurement.mdf._AT_ONCE", 25)
    assert tuple(describe_by_library(locate(path), str(tmp_path))) == whole.tables


@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_channels_that_two_groups_share_are_refused(mdf, version):
    path = mdf(*fast_and_slow(), version=version)
    content = bytearray(path.read_bytes())
    word, at, channel_group = ("<Q", 64 + 24, 32) if version > "4" else ("<I", 64 + 4, 8)
    first = struct.unpack_from(word, content, at)[0]
    second = struct.unpack_from(word, content, first + (24 if version > "4" else 4))[0]
    struct.pack_into(word, content, second + channel_group, struct.unpack_from(word, content, first + channel_group)[0])
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged: two links lead to its block at byte \d+\. Copy it again"):
        read(path, raster=0.1)


def test_an_unfinalized_file_is_read_to_its_end(mdf):
    path = mdf(*fast_and_slow())
    content = bytearray(path.read_bytes())
    (data_group,) = struct.unpack_from("<Q", content, 64 + 24)
    (group,) = struct.unpack_from("<Q", content, data_group + 32)
    struct.pack_into("<Q", content, group + 24 + 8 * 6 + 8, 0)
    path.write_bytes(content)
    with pytest.raises(InputError, match="no channel Speed"):
        read(path, ["Speed"])
    content[:8] = b"UnFinMF "
    content[60:62] = struct.pack("<H", 1)  # says that the counts of samples are still to be made from the data
    path.write_bytes(content)
    assert read(path, ["Speed"]).samples == 201
    assert path.read_bytes() == content


@pytest.mark.parametrize("damage", [b"##DG", b"##XX"])
def test_an_unfinalized_file_leaves_no_copy_behind_even_where_it_is_damaged(mdf, tmp_path, monkeypatch, damage):
    path = mdf(*fast_and_slow())
    content = bytearray(path.read_bytes().replace(b"##DG", damage))
    content[:8], content[60:62] = b"UnFinMF ", struct.pack("<H", 1)
    path.write_bytes(content)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    with contextlib.nullcontext() if damage == b"##DG" else pytest.raises(InputError, match="damaged"):
        read(path, ["Speed"])
    assert list(temporary.iterdir()) == []


def test_files_without_samples_are_reported(mdf):
    with pytest.raises(InputError, match="holds no samples"):
        read(mdf(("a", [signal("Speed", [], np.empty(0))])))
    with pytest.raises(InputError, match="holds no samples"):
        describe(mdf())


def test_a_file_cut_off_anywhere_is_read_or_refused(mdf):
    path = mdf(*fast_and_slow())
    content = path.read_bytes()
    for size in [8, 63, 64, 87, 88, 200, *range(300, len(content), len(content) // 25)]:
        path.write_bytes(content[:size])
        with contextlib.suppress(InputError):
            read(path, raster=0.1)


def test_blocks_that_lead_in_a_circle_are_refused(mdf):
    path = mdf(*fast_and_slow())
    content = bytearray(path.read_bytes())
    (group,) = struct.unpack_from("<Q", content, 64 + 24)
    struct.pack_into("<Q", content, group + 24, group)
    path.write_bytes(content)
    with pytest.raises(InputError, match="leads back"):
        read(path)


def test_a_count_of_samples_beyond_the_file_is_refused(mdf):
    path = mdf(*fast_and_slow())
    content = bytearray(path.read_bytes())
    (group,) = struct.unpack_from("<Q", content, 64 + 24)
    (channels,) = struct.unpack_from("<Q", content, group + 32)
    assert content[channels : channels + 4] == b"##CG"
    struct.pack_into("<Q", content, channels + 24 + 8 * 6 + 8, 10**12)
    path.write_bytes(content)
    with pytest.raises(InputError, match="claims 1000000000000 samples of 16 bytes"):
        read(path)


@pytest.fixture
def frozen_objects():
    """Leave the objects of the other tests out of garbage collections, of which each refused file causes one."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("frozen_objects")
@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("version", "compression"), [("3.30", 0), ("4.10", 0), ("4.10", 2)])
def test_mutated_files_are_read_or_refused(mdf, version, compression, count, capfd):
    states = signal("State", np.arange(6.0), np.array([0, 1, 2, 1, 0, 7], np.uint8), conversion=dict(TEXTS))
    path = mdf(*fast_and_slow(), ("states", [states]), version=version, compression=compression)
    content, dice = path.read_bytes(), random.Random(f"{version} {compression}")
    for _ in range(count):
        mutated = bytearray(content)
        for _ in range(dice.choice([1, 4, 30])):
            mutated[dice.randrange(64 if dice.random() < 0.8 else 8, len(mutated))] = dice.choice(
                [0, 255, dice.randrange(256)]
            )
        path.write_bytes(mutated)
        for look in (describe, lambda p: read(p, raster=0.1)):
            with contextlib.suppress(InputError):
                look(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", FILES)
def test_real_files_are_described_and_read(real, name):
    path = real(f"mdf/{name}")
    tables = describe(path).tables
    for table in tables:
        names = [channel.name for channel in table.channels if channel.name != table.time.channel]
        data = read(path, names)
        assert list(data) == names
        assert data.samples == table.samples
    if len(tables) > 1:
        several = [table.channels[1].name for table in tables]
        assert list(read(path, several, raster=0.1)) == several


def test_real_rasters_equal_what_the_library_interpolates(real):
    from asammdf import MDF

    path = real("mdf/asammdf_ASAP2_Demo_V171.mf4")
    names = ["ASAM.M.SCALAR.FLOAT64.IDENTICAL", "ASAM.M.SCALAR.UBYTE.FORM_X_PLUS_4", "ASAM.M.SCALAR.SLONG.IDENTICAL"]
    data = read(path, names, raster=0.01)
    with MDF(path) as file:
        for name in names:
            interpolated = file.get(name)
            expected = interpolated.interp(data.time, integer_interpolation_mode=0, float_interpolation_mode=1)
            assert not np.isnan(data[name].values).any()
            # a point within 1 ns of a stamp is that sample here, and the one before it there
            assert np.isclose(data[name].values, expected.samples, atol=1e-5).mean() > 0.99


@pytest.mark.parametrize(("unit", "step"), [("ms", 0.1), ("us", 1e-4), ("min", 6000.0), ("s", 100.0), ("", 100.0)])
def test_time_is_read_in_the_unit_that_the_file_states(tmp_path, unit, step):
    path = _with_unit_of_time(tmp_path / "drive.mf4", unit)
    data = read(path)
    np.testing.assert_allclose(data.time, step * np.arange(20))
    assert data.clock.in_milliseconds is (not unit)
    assert read(path, raster=2 * step).samples == 10


def _with_unit_of_time(path, unit):
    """A file with a sample every 100 units."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF

        with MDF(version="4.10") as file:
            file.append([signal("u", 100 * np.arange(20.0), np.arange(20.0))])
            file.groups[0].channels[0].unit = unit
            file.save(path, overwrite=True)
    return path
