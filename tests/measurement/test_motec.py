"""Logs of MoTeC: types, scales, rates, damage."""

import random
from contextlib import suppress

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.race_files import LogChannel, motec_file

RAW = np.arange(5)


@pytest.fixture
def log(tmp_path):
    """Writes a log of some channels."""

    def write(*channels, change=lambda raw: raw):
        path = tmp_path / "lap.ld"
        path.write_bytes(change(motec_file(channels)))
        return path

    return write


@pytest.mark.parametrize(("kind", "sort"), [("<i2", 3), ("<i4", 5), ("<i2", 0), ("<f2", 7), ("<f4", 7)])
def test_samples_of_all_types_are_scaled(log, kind, sort):
    channel = LogChannel("Oil Temp", "°C", RAW.astype(kind), 20, 7, 3, 2, 1, sort)
    data = read(log(channel))
    # value = (raw * 10^-decimals / scale + shift) * multiplier
    np.testing.assert_allclose(data["Oil Temp"].values, (RAW / 2 * 0.1 + 7) * 3)
    np.testing.assert_allclose(data.time, RAW / 20)
    assert data["Oil Temp"].unit == "°C"


def test_negative_decimals_multiply(log):
    assert read(log(LogChannel("RPM", "rpm", RAW.astype("<i2"), decimals=-2)))["RPM"].values.tolist() == [
        0,
        100,
        200,
        300,
        400,
    ]


def test_channels_of_several_rates_are_rasters(log):
    path = log(LogChannel("a", "", RAW.astype("<f4"), 10), LogChannel("b", "", np.arange(9, dtype="<f4"), 20))
    with pytest.raises(InputError, match="different rasters"):
        read(path)
    data = read(path, raster=0.1)
    np.testing.assert_allclose(data["b"].values, 2 * data["a"].values)
    assert [table.name for table in describe(path).tables] == ["10 Hz", "20 Hz"]


def test_a_channel_of_an_unknown_type_is_reported(log):
    path = log(LogChannel("Speed", "km/h", RAW.astype("<i2")), LogChannel("GPS", "", RAW.astype("<f8"), sort=8))
    data = read(path)
    assert list(data) == ["Speed"]
    assert "GPS: has samples of an unknown type" in str(data.findings[0])
    with pytest.raises(InputError, match="unknown type"):
        read(path, ["GPS"])


DAMAGES = {
    "cut off": lambda raw: raw[:-3],
    "an endless list": lambda raw: raw[:1766] + (1762).to_bytes(4, "little") + raw[1770:],
    "a channel beyond the end": lambda raw: raw[:8] + (10**6).to_bytes(4, "little") + raw[12:],
    "too many samples": lambda raw: raw[:1774] + (10**9).to_bytes(4, "little") + raw[1778:],
    "a scale of 0": lambda raw: raw[:1790] + bytes(2) + raw[1792:],
    "too many decimals": lambda raw: raw[:1792] + (400).to_bytes(2, "little") + raw[1794:],
    "no rate": lambda raw: raw[:1784] + bytes(2) + raw[1786:],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_reported(log, damage):
    with pytest.raises(InputError, match="the MoTeC log is damaged"):
        read(log(LogChannel("a", "", RAW.astype("<i2")), change=DAMAGES[damage]))


@pytest.mark.slow
def test_damaged_logs_are_read_or_refused(log):
    rng = random.Random(3)
    whole = motec_file([LogChannel("a", "", RAW.astype("<i2")), LogChannel("b", "", RAW.astype("<f4"), 5)])
    path = log()
    for _ in range(200):
        damaged = bytearray(whole)
        for _ in range(3):
            damaged[rng.choice([rng.randrange(8, 16), rng.randrange(1762, len(whole))])] = rng.randrange(256)
        path.write_bytes(damaged)
        with suppress(InputError):
            read(path, raster=1.0)


def test_an_empty_log_is_reported(log):
    with pytest.raises(InputError, match="holds no channels"):
        read(log())
