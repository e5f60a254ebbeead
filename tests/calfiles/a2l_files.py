"""Small A2L files and images, for tests."""

from kennfeld.calfiles.a2l.parser import parse_a2l
from kennfeld.calfiles.a2l.reader import read_parameters
from kennfeld.calfiles.a2l.writer import write_values
from kennfeld.calfiles.flash.records import read_image
from kennfeld.calfiles.format import FileFindings

COMMON = '/begin MOD_COMMON "" BYTE_ORDER MSB_LAST /end MOD_COMMON'
ADDRESS = 0x1000


def module(*blocks, common=COMMON):
    """The bytes of an A2L file with these blocks in its module."""
    text = "\n".join(["ASAP2_VERSION 1 71", '/begin PROJECT P ""', '/begin MODULE M ""', common, *blocks])
    return f"{text}\n/end MODULE\n/end PROJECT\n".encode()


def layout(*entries, name="RL"):
    return f"/begin RECORD_LAYOUT {name}\n" + "\n".join(entries) + "\n/end RECORD_LAYOUT"


def method(name, kind, entries, unit="-"):
    return f'/begin COMPU_METHOD {name} "" {kind} "%8.3" "{unit}" {entries} /end COMPU_METHOD'


def label(kind, entries="", *, name="L", conversion="NO_COMPU_METHOD", limits="0 0", address=ADDRESS, record="RL"):
    head = f'/begin CHARACTERISTIC {name} "words" {kind} 0x{address:X} {record} 0 {conversion} {limits}'
    return f"{head}\n{entries}\n/end CHARACTERISTIC"


def axis(kind, points, entries="", *, conversion="NO_COMPU_METHOD", quantity="NO_INPUT_QUANTITY", limits="0 0"):
    return f"/begin AXIS_DESCR {kind} {quantity} {conversion} {points} {limits} {entries} /end AXIS_DESCR\n"


def shared_axis(points, entries="", *, name="A", conversion="NO_COMPU_METHOD", address=0x2000, record="RA"):
    head = f'/begin AXIS_PTS {name} "" 0x{address:X} NO_INPUT_QUANTITY {record} 0 {conversion} {points} 0 0'
    return f"{head} {entries} /end AXIS_PTS"


def hex_record(kind, address, content=b""):
    body = bytes([len(content)]) + (address & 0xFFFF).to_bytes(2, "big") + bytes([kind]) + content
    return f":{(body + bytes([-sum(body) % 256])).hex().upper()}"


def s_record(kind, address, content=b"", size=4):
    body = bytes([len(content) + size + 1]) + address.to_bytes(size, "big") + content
    return f"S{kind}{(body + bytes([255 - sum(body) % 256])).hex().upper()}"


def hex_file(memory, width=16, newline="\r\n"):
    """Intel HEX of pieces of memory, by their addresses."""
    lines = []
    for start, content in memory.items():
        for at in range(0, len(content), width):
            address = start + at
            lines.append(hex_record(4, 0, (address >> 16).to_bytes(2, "big")))
            lines.append(hex_record(0, address, content[at : at + width]))
    return newline.join([*lines, hex_record(1, 0), ""]).encode()


def s_file(memory, width=16, newline="\n"):
    """S-records of pieces of memory, by their addresses."""
    lines = [s_record(0, 0, b"test", 2)]
    for start, content in memory.items():
        lines += [s_record(3, start + at, content[at : at + width]) for at in range(0, len(content), width)]
    return newline.join([*lines, s_record(7, 0), ""]).encode()


def image_of(memory):
    findings = FileFindings("ecu.hex")
    image = read_image(hex_file(memory if isinstance(memory, dict) else {ADDRESS: memory}), "ecu.hex", findings)
    assert findings.finish() == ()
    return image


def parsed(raw, include=None):
    findings = FileFindings("ecu.a2l")
    a2l = parse_a2l(raw, "ecu.a2l", findings, include)
    return a2l, [str(one) for one in findings.finish()]


def read(raw, memory):
    """The parameters, and the remarks."""
    a2l, remarks = parsed(raw)
    findings = FileFindings("ecu.a2l")
    parameters = read_parameters(a2l, image_of(memory), findings)
    return parameters, remarks + [str(one) for one in findings.finish()]


def write(raw, memory, change):
    """The image after writing what `change` makes of the parameters, and the remarks; raises `InputError`."""
    a2l, _ = parsed(raw)
    image = image_of(memory)
    current = change(read_parameters(a2l, image, FileFindings("")))
    findings = FileFindings("new.hex")
    content = write_values(a2l, image, current, findings)
    remarks = [str(one) for one in findings.finish()]
    again = FileFindings("")
    return read_image(content, "new.hex", again), remarks
