"""Recordings as bytes, and back."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.measurement.cache import from_parquet, to_parquet
from tests.draws import few_or_many


def bits(values):
    return values.view(np.uint64).tolist()


@few_or_many(
    st.lists(st.floats(width=64), max_size=20),
    st.lists(st.tuples(st.text(max_size=5), st.text(max_size=5)), min_size=1, max_size=4),
    st.booleans(),
    few=15,
    many=300,
)
def test_parquet_keeps_every_bit(values, labels, timed):
    channels = tuple(Channel(f"c{i}", np.array(values) + 0.0 * i, u, d) for i, (u, d) in enumerate(labels))
    data = Dataset("a", channels, np.arange(len(values)) * 0.1 if timed else None)
    back = from_parquet(to_parquet(data), "b")
    assert back.name == "b"
    assert [(c.name, c.unit, c.description) for c in back.channels] == [
        (c.name, c.unit, c.description) for c in channels
    ]
    assert all(
        bits(again.values) == bits(channel.values) for again, channel in zip(back.channels, channels, strict=True)
    )
    assert (back.time is None) == (data.time is None)
    assert back.time is None or bits(back.time) == bits(data.time)


def test_every_missing_value_keeps_its_bits():
    odd = np.array([0x7FF8000000000001, 0xFFF8000000000000, 0x8000000000000000, 1], dtype=np.uint64).view(np.float64)
    back = from_parquet(to_parquet(Dataset("a", (Channel("x", odd),))), "a")
    assert bits(back["x"].values) == bits(odd)


def test_pieces_come_back():
    data = Dataset("a", (Channel("x", [1.0, 2, 3]),), np.array([0.0, 1.0, 0.5]), np.array([0, 2]))
    assert from_parquet(to_parquet(data), "a").piece_starts.tolist() == [0, 2]


def test_values_can_not_be_changed():
    back = from_parquet(to_parquet(Dataset("a", (Channel("x", [1.0]),))), "a")
    assert not back["x"].values.flags.writeable


def test_a_dataset_with_settings_of_a_project_is_not_packed():
    data = Dataset("a", (Channel("x", [1.0]),))
    for changed in ({"weight": 2.0}, {"scored": np.array([True])}, {"use": "test"}, {"max_gap": 1.0}):
        assert to_parquet(replace(data, **changed)) is None
    assert to_parquet(replace(data, channels=())) is None


@pytest.mark.parametrize("content", [b"", b"PAR1", b"no Parquet", b"PAR1" + b"\0" * 100 + b"PAR1"])
def test_bytes_of_another_kind_are_none(content):
    assert from_parquet(content, "a") is None


def test_a_parquet_file_of_another_origin_is_none(tmp_path):
    import pandas as pd

    pd.DataFrame({"a": [1.0]}).to_parquet(tmp_path / "a.parquet")
    assert from_parquet((tmp_path / "a.parquet").read_bytes(), "a") is None
