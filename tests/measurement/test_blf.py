"""Vector BLF: containers and objects, and damage that would keep a reader busy for ever."""

import struct
import zlib
from contextlib import suppress

import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import read
from kennfeld.measurement.blf import read_frames
from kennfeld.measurement.source import locate
from tests.measurement.bus_files import DBC, drive, engine, write_log


def frame(time=0, identifier=500, data=None, flags=0):
    """Return the object of a frame, with its time in ns."""
    data = engine(1000, 80) if data is None else data
    body = struct.pack("<HBBL8s", 1, flags, len(data), identifier, data.ljust(8, b"\0"))
    return struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, 32 + len(body), 1, 2, 0, 0, time) + body


def container(content, method=2):
    packed = zlib.compress(content) if method == 2 else content
    head = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(packed), 10, method, len(content))
    return head + packed + bytes(len(packed) % 4)


def write(tmp_path, *objects):
    path = tmp_path / "log.blf"
    path.write_bytes(struct.pack("<4sL", b"LOGG", 144).ljust(144, b"\0") + b"".join(objects))
    return path


def frames_of(path):
    frames, findings = read_frames(locate(path))
    return sum(map(len, frames)), [str(finding) for finding in findings]


def test_an_object_may_begin_in_one_container_and_end_in_the_next(tmp_path):
    content = b"".join(frame(10 * k) for k in range(10))
    path = write(tmp_path, container(content[:100]), container(content[100:130], method=0), container(content[130:]))
    assert frames_of(path) == (10, [])


def test_objects_outside_of_containers_are_read(tmp_path):
    assert frames_of(write(tmp_path, frame(0), frame(10))) == (2, [])


def test_remote_frames_hold_no_signals(tmp_path):
    assert frames_of(write(tmp_path, container(frame(0) + frame(10, flags=0x80)))) == (1, [])


@pytest.mark.parametrize("size", [0, 1, 15, 2**32 - 1])
def test_an_object_of_an_impossible_size_ends_the_log(tmp_path, size):
    damaged = bytearray(frame(10))
    damaged[8:12] = struct.pack("<L", size)
    count, findings = frames_of(write(tmp_path, container(frame(0)), container(bytes(damaged)), container(frame(20))))
    assert count == 1
    assert "the BLF file is damaged or cut off" in findings[0]
    assert "the 1 frames before are read" in findings[0]


@pytest.mark.parametrize("limit", [1 << 22, pytest.param(1 << 28, marks=pytest.mark.slow)])
def test_a_container_that_expands_beyond_all_bounds_is_refused(tmp_path, monkeypatch, limit):
    monkeypatch.setattr("kennfeld.measurement.blf._MOST_BYTES", limit)
    bomb = container(bytes(limit + limit // 8))
    assert "a container is incomplete" in frames_of(write(tmp_path, container(frame(0)), bomb))[1][0]


def test_a_log_without_frames_is_an_error(tmp_path):
    database = tmp_path / "a.dbc"
    database.write_text(DBC)
    with pytest.raises(InputError, match="holds no data frames of a CAN bus"):
        read(write(tmp_path), dbc=database)


@pytest.mark.parametrize("count", [12, pytest.param(40, marks=pytest.mark.slow)])
def test_every_end_of_a_log_is_noticed(tmp_path, count):
    content = write_log(tmp_path / "drive.blf", drive(200)).read_bytes()
    path = tmp_path / "cut.blf"
    for end in range(160, len(content) - 4, max(len(content) // count, 1)):
        path.write_bytes(content[:end])
        with suppress(InputError):
            assert frames_of(path)[1] != []


def test_a_log_without_data_frames_reports_what_it_contains(tmp_path):
    others = [bytearray(frame(k)) for k in range(3)]
    for other in others:
        struct.pack_into("<L", other, 12, 11)
    path = write(tmp_path, container(b"".join(map(bytes, others)) + frame(flags=0x80)))
    with pytest.raises(InputError, match="holds no data frames of a CAN bus: it holds 3 LIN frames"):
        frames_of(path)
    with pytest.raises(InputError, match="holds no data frames of a CAN bus: it holds nothing"):
        read(write(tmp_path))
