"""Archives of FMUs that are damaged."""

import zipfile
from pathlib import Path

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.fmu.fmu_archive import read_archive


def test_a_damaged_name_of_a_member_is_an_error(tmp_path: Path) -> None:
    """The name stands twice in an archive; here, one of them says UTF-8 and is not."""
    path = tmp_path / "plant.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription/>")
    raw = bytearray(path.read_bytes())
    raw[6:8] = (0x800).to_bytes(2, "little")
    raw[30 + 15] = 0xA1
    path.write_bytes(raw)
    with pytest.raises(InputError, match="is not a readable ZIP archive"):
        read_archive(path)
