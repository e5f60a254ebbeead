"""Files under the name of a model that are something else are named as what they are."""

import zipfile
from pathlib import Path

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.reader.document import document, read_document

OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"


@pytest.mark.parametrize(
    ("name", "raw", "message"),
    [
        ("m.slx", b"", "m.slx: is empty. Copy it again"),
        ("m.mdl", b" \r\n", "m.mdl: is empty"),
        ("m.slx", bytes(500), "is a file of zero bytes"),
        (
            "m.slx",
            b"<!DOCTYPE html><html><body>Not found</body></html>",
            r"is a web page \(HTML\), not a Simulink file",
        ),
        ("m.slx", OLE + b"x" * 600, "is an OLE package: either the model is encrypted by rights management"),
        ("m.slx", OLE + "WordDocument".encode("utf-16-le"), "is a Word document, not a Simulink file"),
        ("m.slx", b"Salted__" + bytes(range(200)), "is an encrypted file, not a Simulink file. Unpack it first"),
        ("m.slxp", bytes(range(256)), "is a protected model, whose blocks cannot be read. Ask its supplier"),
        ("m.slx", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 7\n", "is a Git LFS pointer"),
        ("m.mdl", b"something else", "is not a Simulink file. Simulink files end in .slx or .mdl"),
    ],
)
def test_an_odd_file_is_named_as_what_it_is(name, raw, message):
    with pytest.raises(InputError, match=message):
        document(raw, Path(name))


def test_a_protected_model_in_an_archive_is_named(tmp_path):
    with zipfile.ZipFile(tmp_path / "m.slxp", "w") as archive:
        archive.writestr("encrypted/binary.dat", b"x")
    with pytest.raises(InputError, match=r"m\.slxp: is a protected model"):
        read_document(tmp_path / "m.slxp")
