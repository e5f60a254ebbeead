"""Checks of libraries before they are loaded: loading a truncated one would end the process.

The formats are ELF (Linux), PE (Windows) and Mach-O (macOS). Only what decides whether this machine can load a file is
read: its kind, its processor, and for ELF whether the segments that are mapped into memory are complete.
"""

import platform
import struct
import sys
from pathlib import Path
from typing import NamedTuple

_ELF_PROCESSORS = {"x86_64": 62, "amd64": 62, "i386": 3, "i686": 3, "aarch64": 183, "arm64": 183, "riscv64": 243}
_PE_PROCESSORS = {"amd64": 0x8664, "x86_64": 0x8664, "x86": 0x14C, "arm64": 0xAA64}
# 64 bits, 32 bits (little-endian), and universal files, which hold several processors (big-endian)
_MACH_O_KINDS = (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe")
_LOADED = 1  # segments that are mapped into memory
_HEAD = 4096
_MOST_SEGMENTS = 1000


# ELF header: class (32 or 64 bits) at byte 4, order of bytes at 5, e_machine at 18, e_phoff at 28 or 32, e_phentsize
# and e_phnum at 42 or 54. A segment begins with p_type; p_offset is at 4 or 8, p_filesz at 16 or 32.
class _ElfLayout(NamedTuple):
    """Formats and offsets of ELF with 32 or 64 bits."""

    table: tuple[str, int]  # offset of the segments
    size: int  # place of the size of an entry, followed by their number
    offset: tuple[str, int]
    length: tuple[str, int]


_ELF_LAYOUTS = {1: _ElfLayout(("I", 28), 42, ("I", 4), ("I", 16)), 2: _ElfLayout(("Q", 32), 54, ("Q", 8), ("Q", 32))}


def find_library_problem(path: Path) -> str:
    """Find why this machine cannot load a library; empty if nothing speaks against it."""
    raw = path.read_bytes()[:_HEAD]
    if sys.platform == "win32":
        return _pe_problem(raw)
    if sys.platform == "darwin":
        return "" if raw.startswith(_MACH_O_KINDS) else "it is not a library of macOS"
    return elf_problem(raw, path.stat().st_size, platform.machine().lower())


def elf_problem(raw: bytes, size: int, machine: str) -> str:
    """Find why a machine cannot load an ELF file; empty if nothing speaks against it.

    Args:
        raw: the beginning of the file.
        size: size of the file in bytes.
        machine: name of the processor.

    >>> elf_problem(b"#!/bin/sh", 9, "x86_64")
    'it is not a library of Linux'
    """
    if len(raw) < 64 or raw[:4] != b"\x7fELF" or raw[4] not in _ELF_LAYOUTS or raw[5] not in (1, 2):
        return "it is not a library of Linux"
    order, layout = "<>"[raw[5] - 1], _ELF_LAYOUTS[raw[4]]
    processor, expected = struct.unpack_from(f"{order}H", raw, 18)[0], _ELF_PROCESSORS.get(machine)
    bits = 8 * struct.calcsize("P")
    if (expected is not None and processor != expected) or 32 * raw[4] != bits:
        names = [name for name, number in _ELF_PROCESSORS.items() if number == processor]
        return f"it is for {names[0] if names else f'processor {processor}'} with {32 * raw[4]} bits, not for {machine}"
    table = struct.unpack_from(order + layout.table[0], raw, layout.table[1])[0]
    entry, count = struct.unpack_from(f"{order}HH", raw, layout.size)
    # a table beyond the bytes read here cannot be judged unless the file ends before it
    if table + entry * count > len(raw) or count > _MOST_SEGMENTS:
        return "it is truncated" if size <= len(raw) else ""
    for start in range(table, table + entry * count, entry):
        if struct.unpack_from(f"{order}I", raw, start)[0] != _LOADED:
            continue
        places = ((kind, start + place) for kind, place in (layout.offset, layout.length))
        if sum(struct.unpack_from(order + kind, raw, place)[0] for kind, place in places) > size:
            return "it is truncated"
    return ""


def _pe_problem(raw: bytes) -> str:
    if raw[:2] != b"MZ" or len(raw) < 64:
        return "it is not a library of Windows"
    # e_lfanew: where "PE\0\0" and the COFF header with the processor begin
    start = struct.unpack_from("<I", raw, 60)[0]
    if raw[start : start + 4] != b"PE\0\0" or start + 6 > len(raw):
        return "it is not a library of Windows"
    machine = platform.machine().lower()
    expected, processor = _PE_PROCESSORS.get(machine), struct.unpack_from("<H", raw, start + 4)[0]
    return "" if expected in (None, processor) else f"it is for another processor, not for {machine}"
