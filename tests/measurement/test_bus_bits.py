"""Extraction of bits, compared with the decoder of canmatrix, which takes one frame at a time."""

import logging
import random

import numpy as np
import pytest

from kennfeld.measurement.bus_bits import extract_raw, to_physical, words_of
from kennfeld.measurement.bus_messages import BusSignal
from kennfeld.measurement.dbc import parse_database

FRAMES = 12


def random_database(draw):
    """Return a database with signals of every layout that fits."""
    lines, types = [], []
    for number in range(1, 13):
        size = draw.choice([1, 2, 4, 8, 8, 12, 64])
        lines.append(f"BO_ {number} M{number}: {size} X")
        for k in range(6):
            signal = random_signal(draw, size)
            order, sign = 0 if signal.big_endian else 1, draw.choice("+-")
            scale = f"({draw.choice([1, 0.25, -0.5])},{draw.choice([0, -40, 1.5])})"
            lines.append(f' SG_ S{k} : {signal.start}|{signal.length}@{order}{sign} {scale} [0|0] "" X')
            if signal.length in (32, 64) and draw.random() < 0.5:
                types.append(f"SIG_VALTYPE_ {number} S{k} : {signal.length // 32};")
    return "\n".join([*lines, *types, ""])


def random_signal(draw, size):
    while True:
        length = draw.choice([32, 64, draw.randint(1, 64)])
        signal = BusSignal("S", draw.randrange(8 * size), min(length, 8 * size), draw.random() < 0.5)
        if signal.bytes <= size:
            return signal


@pytest.mark.parametrize("seed", range(8))
def test_random_signals_have_the_values_of_another_decoder(seed):
    formats = pytest.importorskip("canmatrix.formats")
    logging.getLogger("canmatrix").setLevel(logging.CRITICAL)
    draw = random.Random(seed)
    text = random_database(draw)
    (matrix,) = formats.loads(text.encode(), import_type="dbc").values()
    for message, other in zip(parse_database("a.dbc", text).messages, matrix.frames, strict=True):
        payload = np.frombuffer(draw.randbytes(FRAMES * message.size), np.uint8).reshape(FRAMES, -1)
        expected = [other.decode(row.tobytes()) for row in payload]
        words = words_of(payload)
        for signal in message.signals:
            values = to_physical(extract_raw(words, signal), signal)
            with np.errstate(invalid="ignore"):
                assert np.allclose(
                    values,
                    [float(frame[signal.name].phys_value) for frame in expected],
                    rtol=1e-12,
                    atol=1e-9,
                    equal_nan=True,
                )


def test_integers_of_64_bits_keep_their_sign():
    payload = np.array([[0xFF] * 8, [0] * 7 + [0x80]], np.uint8)
    values = to_physical(extract_raw(payload, signal := BusSignal("a", 0, 64, kind="i")), signal)
    assert values.tolist() == [-1.0, -(2.0**63)]


@pytest.mark.parametrize(
    ("length", "raw", "missing"),
    [
        (8, 0xFA, False),
        (8, 0xFB, True),
        (8, 0xFE, True),
        (8, 0xFF, True),
        (16, 0xFAFF, False),
        (16, 0xFE00, True),
        (32, 0xFB000000, True),
        (2, 2, False),
        (2, 3, True),
        (1, 1, False),
        (5, 31, True),
        (64, 2**64 - 1, True),
    ],
)
def test_raw_values_of_j1939_without_a_measured_value_are_missing(length, raw, missing):
    payload = np.frombuffer(raw.to_bytes(8, "little"), np.uint8).reshape(1, 8)
    values = extract_raw(payload, signal := BusSignal("a", 0, length))
    assert np.isnan(to_physical(values, signal, is_j1939=True)[0]) == missing
    assert not np.isnan(to_physical(values, signal)[0])


def test_a_state_of_j1939_lacks_only_error_and_not_available():
    signal = BusSignal("a", 0, 8, texts=((251, "special"), (255, "not available")))
    payload = np.zeros((4, 8), np.uint8)
    payload[:, 0] = [251, 253, 254, 255]
    values = to_physical(extract_raw(payload, signal), signal, is_j1939=True)
    assert np.isnan(values).tolist() == [False, False, True, True]
