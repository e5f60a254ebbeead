"""Intel HEX and S-records: memory without gaps, findings by line, and files that change in their numbers alone."""

from pathlib import Path

import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.calfiles.flash.records import read_image
from kennfeld.calfiles.format import FileFindings
from kennfeld.files.calibrations import IMAGE
from kennfeld.files.head import FileHead
from tests.calfiles.a2l_files import hex_file, hex_record, s_file, s_record
from tests.draws import few_or_many

END = hex_record(1, 0)


def image(*lines, newline="\n"):
    findings = FileFindings("ecu.hex")
    memory = read_image(newline.join(lines).encode("latin-1"), "ecu.hex", findings)
    return memory, [str(one) for one in findings.finish()]


def errors(*lines):
    with pytest.raises(InputError) as caught:
        image(*lines)
    return [str(one) for one in caught.value.findings]


def test_a_record_of_the_intel_specification_is_read():
    memory, remarks = image(":0300300002337A1E", ":00000001FF")
    assert memory.read(0x30, 3) == b"\x02\x33\x7a"
    assert (memory.kind, memory.size, remarks) == ("Intel HEX", 3, [])


def test_the_upper_half_of_an_address_comes_from_a_record_of_its_own():
    memory, _ = image(hex_record(4, 0, b"\x00\x81"), hex_record(0, 0x10, b"\x01\x02"), END)
    assert memory.read(0x810010, 2) == b"\x01\x02"


def test_a_segment_starts_at_sixteen_times_its_number_and_wraps_at_its_end():
    memory, _ = image(hex_record(2, 0, b"\x10\x00"), hex_record(0, 0xFFFF, b"\x01\x02"), END)
    assert memory.read(0x1FFFF, 1) == b"\x01"
    assert memory.read(0x10000, 1) == b"\x02"


def test_start_addresses_are_not_memory():
    memory, remarks = image(hex_record(3, 0, bytes(4)), hex_record(5, 0, bytes(4)), hex_record(0, 0, b"\x07"), END)
    assert (memory.size, remarks) == (1, [])


def test_distant_segments_take_no_memory_between_them():
    memory, _ = image(hex_record(0, 0, b"\x01"), hex_record(4, 0, b"\xff\xff"), hex_record(0, 0xFFF0, b"\x02"), END)
    assert [(one.address, one.content) for one in memory.segments] == [(0, b"\x01"), (0xFFFFFFF0, b"\x02")]
    assert memory.read(0, 2) is None
    assert not memory.holds(0xFFFFFFF0, 2)


def test_records_in_any_order_make_one_piece():
    memory, _ = image(hex_record(0, 4, b"\x03\x04"), hex_record(0, 2, b"\x01\x02"), END)
    assert memory.read(2, 4) == b"\x01\x02\x03\x04"


def test_every_wrong_checksum_is_reported_with_its_line():
    good = hex_record(0, 0, b"\x01")
    messages = errors(good[:-2] + "00", good, hex_record(0, 1, b"\x01")[:-2] + "11", END)
    assert "ecu.hex line 1: has the checksum 00, but its bytes give FE" in messages[0]
    assert "ecu.hex line 3: has the checksum 11, but its bytes give FD" in messages[1]
    assert len(messages) == 2


def test_only_the_first_of_very_many_wrong_lines_are_reported():
    messages = errors(*[":0100000001FF"] * 500, END)
    assert len(messages) == 21
    assert "480 further lines up to here with a wrong checksum" in messages[-1]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([hex_record(0, 0, b"\x01"), "nonsense", END], "line 2: is not an Intel HEX record"),
        ([":02000000010", END], "line 1: is not an Intel HEX record"),
        ([":0200000001FD", END], "states 2 bytes, but contains 1"),
        ([hex_record(7, 0, b"\x01"), END], "is a record of unknown type 07"),
        ([hex_record(0, 0, b"\x01")], "has no end record (:00000001FF)"),
        ([END], "contains no data"),
        ([""], "is empty"),
        (["MDF"], "is neither an Intel HEX nor an S-record file"),
        ([s_record(3, 0, b"\x01")[:-2] + "00"], "has the checksum 00"),
        ([s_record(3, 0, b"\x01"), s_record(5, 2, size=2)], "states 2 records, but there are 1"),
        ([s_record(3, 0, b"\x01"), "S9zz"], "is not an S-record"),
    ],
)
def test_what_is_wrong_has_a_finding(lines, message):
    assert message in "\n".join(errors(*lines))


def test_blank_lines_and_end_marks_around_the_records_are_accepted():
    memory, remarks = image("", hex_record(0, 0, b"\x01"), "", END, "\x1a", "", newline="\r\n")
    assert (memory.size, remarks) == (1, [])


def test_records_behind_the_end_are_reported():
    _, remarks = image(hex_record(0, 0, b"\x01"), END, hex_record(0, 1, b"\x01"))
    assert remarks == ["ecu.hex line 3: content after the end record; skipped"]


def test_the_last_of_overlapping_records_counts():
    memory, remarks = image(hex_record(0, 0, b"\x01\x02\x03"), hex_record(0, 1, b"\x09"), END)
    assert memory.read(0, 3) == b"\x01\x09\x03"
    assert "1 record overlap with others, the first at 0x1; the last record takes precedence" in remarks[0]
    assert "1 byte differ, the first at 0x1: 02 (line 1) and 09 (line 2)" in remarks[0]
    _, remarks = image(hex_record(0, 0, b"\x01\x02\x03"), hex_record(0, 1, b"\x02"), END)
    assert remarks[0].endswith("their bytes are equal")
    again, _ = image(memory.changed({1: b"\x05"}).decode())
    assert again.read(0, 3) == b"\x01\x05\x03"


@pytest.mark.parametrize(("kind", "size"), [(1, 2), (2, 3), (3, 4)])
def test_s_records_have_addresses_of_three_lengths(kind, size):
    memory, remarks = image(
        s_record(kind, 0x1234, b"\x05\x06", size), s_record(5, 1, size=2), s_record(10 - kind, 0, b"", size)
    )
    assert memory.read(0x1234, 2) == b"\x05\x06"
    assert (memory.kind, remarks) == ("S-records", [])


def test_s_records_without_an_end_are_reported():
    assert "has no end record (S7, S8 or S9)" in image(s_record(3, 0, b"\x01"))[1][0]


def test_an_image_is_recognised_by_its_beginning():
    starts = (b":020000040000FA\r\n", b"S00600004844521B\n", b"STUETZSTELLENVERTEILUNG a 3", b": what follows")
    assert [IMAGE.recognises(FileHead(Path("a"), start)) for start in starts] == [True, True, False, False]


def test_a_change_outside_the_memory_is_refused():
    memory, _ = image(hex_record(0, 0, b"\x01"), END)
    with pytest.raises(ArgumentError, match="2 bytes at 0x0 are not in"):
        memory.changed({0: b"\x01\x02"})


def test_small_letters_stay_small():
    memory, _ = image(hex_record(0, 0, b"\xab\xcd").lower(), END)
    assert memory.changed({0: b"\xef"}).decode().splitlines()[0] == hex_record(0, 0, b"\xef\xcd").lower()


pieces = st.dictionaries(
    st.integers(0, 2**16).map(lambda i: i * 0x10000), st.binary(min_size=1, max_size=300), min_size=1, max_size=4
)


@few_or_many(
    memory=pieces,
    file=st.sampled_from([hex_file, s_file]),
    width=st.integers(1, 64),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    data=st.data(),
    few=20,
    many=100,
)
def test_only_the_digits_of_changed_bytes_and_their_checksums_change(memory, file, width, newline, data):
    memory = {address % 2**32: content for address, content in memory.items()}
    raw, findings = file(memory, width, newline), FileFindings("")
    flash = read_image(raw, "ecu", findings)
    findings.finish()
    assert {one.address: one.content for one in flash.segments} == memory
    assert flash.changed({}) == raw
    start = data.draw(st.sampled_from(sorted(memory)))
    at = data.draw(st.integers(0, len(memory[start]) - 1))
    new = data.draw(st.binary(min_size=1, max_size=len(memory[start]) - at))
    wanted = memory | {start: memory[start][:at] + new + memory[start][at + len(new) :]}
    changed = flash.changed({start + at: new})
    assert changed == file(wanted, width, newline)
