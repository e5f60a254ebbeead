"""Libraries that this machine cannot load are refused before it tries."""

import struct
import sys
import zipfile

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.fmu.fmu_archive import digest_of
from kennfeld.importers.fmu.instance import load_instance
from kennfeld.importers.fmu.library_format import elf_problem
from tests.importers.fmu.lag_fmu import build, description_2, pack

HEAD, SEGMENT = 64, 56


def elf(processor=62, bits=64, order="<", length=1000):
    """An ELF file with one segment that is mapped into memory."""
    kinds = {64: ("Q", 32, 54, 8, 32), 32: ("I", 28, 42, 4, 16)}[bits]
    table, count, offset, size = kinds[1:]
    raw = bytearray(HEAD + SEGMENT)
    raw[:6] = b"\x7fELF" + bytes([bits // 32, 1 if order == "<" else 2])
    struct.pack_into(f"{order}H", raw, 18, processor)
    struct.pack_into(order + kinds[0], raw, table, HEAD)
    struct.pack_into(f"{order}HH", raw, count, SEGMENT, 1)
    struct.pack_into(f"{order}I", raw, HEAD, 1)
    struct.pack_into(order + kinds[0], raw, HEAD + offset, 0)
    struct.pack_into(order + kinds[0], raw, HEAD + size, length)
    return bytes(raw)


@pytest.mark.skipif(sys.maxsize < 2**32, reason="expects a process of 64 bits")
@pytest.mark.parametrize(
    ("raw", "size", "machine", "problem"),
    [
        (elf(), 1000, "x86_64", ""),
        (elf(183), 1000, "aarch64", ""),
        (elf(183), 1000, "x86_64", "it is for aarch64 with 64 bits, not for x86_64"),
        (elf(3, 32), 1000, "x86_64", "it is for i386 with 32 bits, not for x86_64"),
        (elf(8, order=">"), 1000, "x86_64", "it is for processor 8 with 64 bits, not for x86_64"),
        (elf(8, order=">"), 1000, "mips64", ""),
        (elf(), 999, "x86_64", "it is truncated"),
        (elf()[:80], 80, "x86_64", "it is truncated"),
        (elf()[:20], 20, "x86_64", "it is not a library of Linux"),
        (b"", 0, "x86_64", "it is not a library of Linux"),
    ],
)
def test_reasons_against_a_library_are_named(raw, size, machine, problem):
    assert elf_problem(raw, size, machine) == problem


@pytest.mark.skipif(sys.platform != "linux", reason="the segments of other formats are not read")
def test_a_truncated_library_is_not_loaded(tmp_path):
    with zipfile.ZipFile(build(tmp_path, 2)) as archive:
        library = next(name for name in archive.namelist() if name.endswith(".so"))
        raw = archive.read(library)
    broken = tmp_path / "half" / "lag.so"
    broken.parent.mkdir()
    broken.write_bytes(raw[: len(raw) // 2])
    path = pack(tmp_path / "half.fmu", description_2(), library=broken)
    with pytest.raises(InputError, match="cannot be loaded: it is truncated"):
        load_instance(str(path), digest_of(path))
