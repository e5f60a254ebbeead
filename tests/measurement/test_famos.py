"""FAMOS files of imc: types, scales, times, bits, damage."""

import random
from contextlib import suppress

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.race_files import Component, famos_curve, famos_file, key

RAW = np.arange(5)
START = (28, 11, 2026, 10, 15, 30.0)


@pytest.fixture
def file(tmp_path):
    """Writes a file of some curves."""

    def write(*curves, **options):
        path = tmp_path / "bench.raw"
        path.write_bytes(famos_file(*curves, **options))
        return path

    return write


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8", "u8", "i8"])
def test_samples_of_all_types_are_scaled(file, kind, order):
    curve = famos_curve("Öltemp", Component(RAW.astype(kind), "°C", 0.5, -40.0), step=0.25, comment="oil", order=order)
    data = read(file(curve, processor=1 if order == "<" else 2))
    np.testing.assert_allclose(data["Öltemp"].values, 0.5 * RAW - 40)
    np.testing.assert_allclose(data.time, 0.25 * RAW)
    assert (data["Öltemp"].unit, data["Öltemp"].description) == ("°C", "oil")


def test_values_beyond_the_largest_number_are_missing(file):
    data = read(file(famos_curve("p", Component(np.array([1.0, 1e300]), "bar", 1e10))))
    np.testing.assert_array_equal(data["p"].values, [1e10, np.nan])
    assert "infinite" in str(data.findings[0])


def test_steps_in_milliseconds_and_a_first_time_count(file):
    curve = famos_curve("a", Component(RAW.astype("f4")), step=10.0, unit="ms", origin=500.0)
    np.testing.assert_allclose(read(file(curve)).time, 0.5 + 0.01 * RAW)


def test_a_second_component_is_the_time(file):
    stamps = Component(np.array([0, 100, 250, 300, 1000]), "s", 1e-3, kind=13)
    data = read(file(famos_curve("a", Component(RAW.astype("f4"), "bar"), stamps)))
    np.testing.assert_allclose(data.time, [0, 0.1, 0.25, 0.3, 1])
    assert data["a"].values.tolist() == RAW.tolist()


def test_a_second_component_in_another_unit_is_a_channel(file):
    path = file(famos_curve("p", Component(RAW.astype("f4"), "bar"), Component(10.0 * RAW, "mm")))
    data = read(path)
    assert data.time is None
    assert (data["p x"].values.tolist(), data["p x"].unit) == ([0, 10, 20, 30, 40], "mm")


def test_channels_triggered_later_begin_later(file):
    first = famos_curve("a", Component(RAW.astype("f4")), trigger=START)
    second = famos_curve("b", Component(2 + RAW.astype("f4")), trigger=START, delay=0.2, number=2)
    data = read(file(first, second), raster=0.1)
    np.testing.assert_allclose(data.time, [0.2, 0.3, 0.4])
    np.testing.assert_allclose(data["a"].values, data["b"].values)


def test_channels_of_one_time_are_one_group(file):
    curves = [famos_curve(name, Component(RAW.astype("f4")), number=k) for k, name in enumerate("abc", 1)]
    assert list(read(file(*curves))) == ["a", "b", "c"]
    assert len(describe(file(*curves)).tables) == 1


def test_bits_of_digital_channels_are_channels(file):
    curve = famos_curve("", Component(np.array([0, 1, 2, 3, 1], "u2"), kind=11), names=[("Left", 1), ("Right", 2)])
    data = read(file(curve))
    assert data["Left"].values.tolist() == [0, 1, 0, 1, 1]
    assert data["Right"].values.tolist() == [0, 0, 1, 1, 0]


def test_names_with_commas_and_semicolons_are_read(file):
    data = read(file(famos_curve("a,b;|c", Component(RAW.astype("f4")), comment="x,y")))
    assert (list(data), data["a,b;|c"].description) == (["a,b;|c"], "x,y")


def test_samples_of_an_unknown_type_are_reported(file):
    good = famos_curve("a", Component(RAW.astype("f4")))
    data = read(file(good, famos_curve("b", Component(RAW.astype("u2"), kind=9), number=2)))
    assert list(data) == ["a"]
    assert "channel b: has samples of type 9 in 2 bytes" in str(data.findings[0])


DAMAGES = {
    "cut off": (lambda raw: raw[:-12], "claims"),
    "no key": (lambda raw: raw.replace(b"|CP", b"?CP"), "there is no key"),
    "a large buffer": (lambda raw: raw.replace(b"1,0,1,1,0,20,0,20", b"1,0,1,1,0,99,0,99"), "a buffer claims 99 bytes"),
    "a component without a curve": (lambda raw: raw[:10] + key("CR", 1, 1.0, 0.0, 1, "V") + raw[10:], "component"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_reported(tmp_path, damage):
    change, message = DAMAGES[damage]
    path = tmp_path / "x.raw"
    whole = famos_file(famos_curve("a", Component(RAW.astype("f4"))))
    path.write_bytes(change(whole))
    with pytest.raises(InputError, match=f"FAMOS file is damaged or cut off.*(?:{message})"):
        read(path)


def test_damaged_files_are_read_or_refused(tmp_path):
    rng = random.Random(4)
    stamps = Component(np.arange(5), "s", 1e-3, kind=13)
    whole = famos_file(famos_curve("a", Component(RAW.astype("f4"), "bar"), stamps, trigger=START))
    for _ in range(300):
        damaged = bytearray(whole)
        for _ in range(2):
            damaged[rng.randrange(8, len(whole))] = rng.choice([rng.randrange(256), rng.choice(b"0123456789,-")])
        (tmp_path / "x.raw").write_bytes(damaged)
        with suppress(InputError):
            read(tmp_path / "x.raw")


def test_a_file_without_channels_is_reported(file):
    with pytest.raises(InputError, match="holds no channels"):
        read(file())
