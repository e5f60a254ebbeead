"""The parts of a Simulink file: the members of a zip (`.slx`, `.sldd`), or of the text that newer `.mdl` files are."""

import base64
import binascii
import io
import re
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

from kennfeld.archives import overgrown
from kennfeld.models.simulink.reader.section_tree import ReadDiagnostics, SectionNode, json_section, xml_section

__all__ = ["ModelPackage", "is_text_package", "is_zip", "text_package", "zip_package"]

_BEGIN = b"__MWOPC_PART_BEGIN__"
_PACKAGE = re.compile(rb"^__MWOPC_PACKAGE_BEGIN__[ \t]*(\S*)", re.MULTILINE)
_PART = re.compile(rb"^__MWOPC_PART_BEGIN__[ \t]++(\S++)[ \t]*+([^\n]*+)\n", re.MULTILINE)
_END = re.compile(rb"^__MWOPC_PACKAGE_END__", re.MULTILINE)
_COPY = "Take a complete copy of the file."
_ALWAYS = 50_000_000  # bytes that any file may unpack to
_DENSEST = 60  # times; XML of models shrinks to a tenth, to a thirtieth where blocks repeat themselves


@dataclass
class ModelPackage:
    """Named parts of a file; names have no slash in front. `room` is how many bytes may still be unpacked."""

    diagnostics: ReadDiagnostics
    members: dict[str, zipfile.ZipInfo] = field(default_factory=dict)
    archive: zipfile.ZipFile | None = None
    texts: dict[str, bytes] = field(default_factory=dict)
    release: str = ""
    room: int = _ALWAYS

    def __contains__(self, name: str) -> bool:
        return name in self.members or name in self.texts

    def names(self) -> Iterator[str]:
        """The names of all parts."""
        yield from self.texts or self.members

    def raw(self, name: str) -> bytes | None:
        """The bytes of a part; None where there is none, or with an error noted where it cannot be unpacked."""
        if name in self.texts:
            return self.texts[name]
        if name not in self.members or self.archive is None:
            return None
        try:
            return self._unpacked(self.members[name], self.archive)
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError) as error:
            # RuntimeError covers what is encrypted, NotImplementedError methods of compression nobody uses
            self.diagnostics.error(name, f"cannot be unpacked: {error or type(error).__name__}", _COPY)
            return None

    def _unpacked(self, member: zipfile.ZipInfo, archive: zipfile.ZipFile) -> bytes | None:
        with archive.open(member) as stream:
            raw = stream.read(self.room + 1)
        self.room -= len(raw)
        if self.room < 0:
            self.diagnostics.error(member.filename[:80], "unpacks to far more than a model of this size holds", _COPY)
            self.room = 0
            return None
        return raw

    def section(self, name: str, fold: bool = True) -> SectionNode | None:
        """An XML or JSON part as a section; None where there is none, or with an error noted where it is broken."""
        raw = self.raw(name)
        if raw is None:
            return None
        return (
            json_section(raw, name, self.diagnostics)
            if name.endswith(".json")
            else xml_section(raw, name, self.diagnostics, fold)
        )


def is_zip(raw: bytes) -> bool:
    """Whether bytes begin as a zip archive does."""
    return raw[:4] in (b"PK\3\4", b"PK\5\6")


def is_text_package(raw: bytes) -> bool:
    """Whether a text holds the parts of a package."""
    return _BEGIN in raw


def zip_package(raw: bytes, diagnostics: ReadDiagnostics) -> ModelPackage:
    """The members of a zip archive; without any, and an error noted, where it is broken or a bomb."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(raw))
        members = {member.filename.lstrip("/"): member for member in archive.infolist()}
        too_much = overgrown(archive)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, NotImplementedError, RuntimeError) as error:
        diagnostics.error(
            "", f"is a broken zip archive: {error}", "The file may be cut off: " + _COPY[0].lower() + _COPY[1:]
        )
        return ModelPackage(diagnostics)
    if too_much:
        diagnostics.error("", f"unpacks to far more than a model holds: {too_much}", _COPY)
        return ModelPackage(diagnostics)
    return ModelPackage(diagnostics, members, archive, room=max(_ALWAYS, _DENSEST * len(raw)))


def text_package(raw: bytes, diagnostics: ReadDiagnostics) -> ModelPackage:
    """The parts of a text package: a header line each, then XML as it is, or bytes in base 64."""
    end = _END.search(raw)
    if end is None:
        raise diagnostics.refuse("", "is cut off: the text package has no end", _COPY)
    release = _PACKAGE.search(raw)
    found = list(_PART.finditer(raw))
    stops = [*(part.start() for part in found[1:]), end.start()]
    texts = {}
    for part, stop in zip(found, stops, strict=False):
        name = part[1].decode("utf-8", "replace").lstrip("/")
        texts[name] = _content(raw[part.end() : stop], part[2].strip().upper() == b"BASE64", name, diagnostics)
    named = release[1].decode("ascii", "replace") if release else ""
    return ModelPackage(diagnostics, texts=texts, release=named)


def _content(raw: bytes, encoded: bool, name: str, diagnostics: ReadDiagnostics) -> bytes:
    if not encoded:
        return raw
    try:
        return base64.b64decode(raw)
    except (binascii.Error, ValueError) as error:
        diagnostics.remark(f"{name[:80]} cannot be decoded: {error}")
        return b""
