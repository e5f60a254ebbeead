"""Conversions of MDF: every type with every type of raw value, by the formulas of the standard."""

import math
import warnings
from contextlib import nullcontext
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from kennfeld.measurement import describe, mdf, read
from kennfeld.measurement.sorted_mdf import SortedFile, UnusualLayoutError
from kennfeld.measurement.source import locate
from kennfeld.measurement.table import Selection

RAW_TYPES = ["u1", "i1", "<u2", ">u2", "<i4", ">i4", "<u8", "<f4", ">f4", "<f8", "<f2"]
RAW = [0, 1, 4, 5, 6, 14, 20, 30, 60, 100]


def ranges(raw, is_float, spans, default):
    """Return the value of the first range: without its upper limit if raw values are floating-point."""
    for low, high, value in spans:
        if low <= raw and (raw < high if is_float else raw <= high):
            return value
    return default


def nearest(raw, points):
    return min(points, key=lambda point: (abs(raw - point[0]), point[0]))[1]


POINTS = [(0, 100.0), (4, 120.0), (30, 200.5)]
SPANS = [(0, 5, 7.0), (6, 19, 8.0)]
KINDS = {
    "linear": ({"a": 0.1, "b": -40.3}, lambda x, _: 0.1 * x - 40.3),
    "rational": (
        {f"P{k}": v for k, v in enumerate((1.0, 2.0, 3.0, 0.5, 4.0, 5.0), 1)},
        lambda x, _: (x * x + 2 * x + 3) / (0.5 * x * x + 4 * x + 5),
    ),
    "factor": ({f"P{k}": v for k, v in enumerate((0, 3.0, 0, 0, 0, 7.0), 1)}, lambda x, _: x * 3.0 / 7.0),
    "formula": ({"formula": "(X1+2)*exp(-X1/10)"}, lambda x, _: (x + 2) * math.exp(-x / 10)),
    "interpolated": (
        {f"raw_{i}": p[0] for i, p in enumerate(POINTS)} | {f"phys_{i}": p[1] for i, p in enumerate(POINTS)}
        | {"interpolation": True},
        lambda x, _: float(np.interp(x, *zip(*POINTS, strict=True))),
    ),
    "nearest": (
        {f"raw_{i}": p[0] for i, p in enumerate(POINTS)} | {f"phys_{i}": p[1] for i, p in enumerate(POINTS)}
        | {"interpolation": False},
        lambda x, _: nearest(x, POINTS),
    ),
    "ranges": (
        {f"{name}_{i}": span[k] for i, span in enumerate(SPANS) for k, name in enumerate(("lower", "upper", "phys"))}
        | {"default": -1.0},
        lambda x, is_float: ranges(x, is_float, SPANS, -1.0),
    ),
}  # fmt: skip


def scale(factor, offset):
    return {"a": factor, "b": offset}


MIXED = {
    "texts": (
        {"val_0": 100, "text_0": "SNA", "val_1": 60, "text_1": "fault", "default_addr": scale(0.5, -40.0)},
        lambda x, _: math.nan if x in (60, 100) else 0.5 * x - 40.0,
    ),
    "text ranges": (
        {
            "lower_0": 60, "upper_0": 101, "text_0": "SNA", "lower_1": 0, "upper_1": 30,
            "text_1": scale(0.25, 1.0), "default_addr": "no range",
        },
        lambda x, is_float: ranges(x, is_float, [(60, 101, math.nan), (0, 30, 0.25 * x + 1)], math.nan),
    ),
}  # fmt: skip


def write(path, raw, conversion, unit="degC", version="4.10", **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF, Signal
        from asammdf.blocks.conversion_utils import from_dict

        block = from_dict(conversion) if isinstance(conversion, dict) else conversion
        with MDF(version=version) as file:
            samples = np.asarray(raw)
            stamps = 0.1 * np.arange(samples.size)
            file.append(
                [Signal(samples, stamps, name="x", unit=unit, conversion=block, raw=True, **more)],
                common_timebase=True,
            )
            return file.save(path, overwrite=True)


def read_both(path):
    """Return the channel read with and without the library."""
    source = locate(path)
    with TemporaryDirectory() as folder, mdf._open(source, folder) as file:
        column = mdf._read(source, file, Selection())[0].columns[1]
    own = read(path)["x"]
    np.testing.assert_array_equal(column.values, own.values)
    return own


@pytest.mark.parametrize(("nested", "without_library"), [(4, True), (5, False)])
def test_conversions_within_tables_are_read_to_any_depth(tmp_path, nested, without_library):
    conversion = scale(2.0, 1.0)
    for level in range(nested):
        conversion = {"val_0": 100.0 + level, "text_0": f"code {level}", "default_addr": conversion}
    path = write(tmp_path / "x.mf4", np.uint8([0, 1, 7, 100]), conversion)
    np.testing.assert_array_equal(read_both(path).values, [1.0, 3.0, 15.0, math.nan])
    with nullcontext() if without_library else pytest.raises(UnusualLayoutError), SortedFile(path):
        pass


@pytest.mark.parametrize("raw_type", RAW_TYPES)
@pytest.mark.parametrize("kind", [*KINDS, *MIXED])
def test_values_are_those_of_the_standard(tmp_path, kind, raw_type):
    conversion, formula = (KINDS | MIXED)[kind]
    raw = np.array(RAW, dtype=raw_type)
    channel = read_both(write(tmp_path / "x.mf4", raw, conversion))
    wanted = [formula(float(x), raw.dtype.kind == "f") for x in raw]
    np.testing.assert_allclose(channel.values, wanted, rtol=4e-16, atol=1e-14)


def test_long_recordings_have_the_same_values(tmp_path):
    raw = np.resize(np.array(RAW, dtype="u2"), 1000)
    conversion, formula = MIXED["text ranges"]
    channel = read_both(write(tmp_path / "x.mf4", raw, conversion))
    np.testing.assert_allclose(channel.values, [formula(float(x), False) for x in raw])


def test_texts_among_numbers_are_missing_and_reported(tmp_path):
    conversion = {
        "val_0": 65535,
        "text_0": "SNA",
        "val_1": 65534,
        "text_1": "fault",
        "default_addr": scale(0.125, -273),
    }
    path = write(tmp_path / "x.mf4", np.array([0, 65535, 100, 65535, 65534, 8], dtype="u2"), conversion)
    data = read(path)
    np.testing.assert_array_equal(data["x"].values, [-273, np.nan, -260.5, np.nan, np.nan, -272])
    [finding] = data.findings
    assert finding.severity == "remark"
    assert "x (3 of 6: SNA, fault)" in finding.message
    fine = read(path, raster=0.05)["x"].values
    assert fine[5] == pytest.approx((-260.5 - 273) / 2, abs=20)  # between its neighbours, not held


@pytest.mark.parametrize(
    ("unit", "texts", "values"),
    [
        ("", {0: "N", 1: "first"}, [0, 1, 7]),  # a state, whatever its other values are
        ("rpm", {0: "standstill"}, [np.nan, 1, 7]),
        ("", {7: "SNA"}, [0, 1, np.nan]),  # a counter
    ],
)
def test_an_identical_scale_beside_texts_makes_a_number_if_it_has_a_unit(tmp_path, unit, texts, values):
    conversion = {"default_addr": scale(1.0, 0.0)}
    for i, (value, text) in enumerate(texts.items()):
        conversion |= {f"val_{i}": value, f"text_{i}": text}
    np.testing.assert_array_equal(
        read(write(tmp_path / "x.mf4", np.uint8([0, 1, 7]), conversion, unit))["x"].values, values
    )


def test_values_of_texts_are_numbers(tmp_path):
    from asammdf.blocks.v4_blocks import ChannelConversion

    conversion = ChannelConversion(conversion_type=9, links_nr=6, val_0=0.0, val_1=1.5, val_default=-1.0)
    conversion.referenced_blocks = {"text_0": b"off", "text_1": b"on"}
    path = write(tmp_path / "x.mf4", np.array([b"on", b"off", b"?"]), conversion, encoding="utf-8")
    assert read(path)["x"].values.tolist() == [1.5, 0.0, -1.0]


def test_an_unknown_formula_is_reported(tmp_path):
    path = write(tmp_path / "x.mf4", np.uint8([0, 1, 7]), {"formula": "X1^2"})
    [finding] = describe(path).tables[0].findings
    assert finding.severity == "warning"
    assert "X1^2" in finding.message


@pytest.mark.parametrize("raw_type", ["u1", "<i4", "<f4", "<f8"])
@pytest.mark.parametrize("kind", ["linear", "rational", "formula", "interpolated", "nearest"])
def test_version_3_has_the_same_formulas(tmp_path, kind, raw_type):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF

        conversion, formula = KINDS[kind]
        if kind == "formula":
            conversion, formula = {"formula": "(X+2)*3"}, lambda x, _: (x + 2) * 3  # which the library can write
        raw = np.array(RAW, dtype=raw_type)
        with MDF(write(tmp_path / "x.mf4", raw, conversion)) as file:
            path = file.convert("3.30").save(tmp_path / "x.mdf")
    wanted = [formula(float(x), raw.dtype.kind == "f") for x in raw]
    np.testing.assert_allclose(read(path)["x"].values, wanted, rtol=4e-16, atol=1e-14)
