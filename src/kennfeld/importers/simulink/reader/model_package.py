"""Parts of a Simulink file: members of a zip archive (`.slx`, `.sldd`), or of a text package of newer `.mdl` files."""

import base64
import binascii
import io
import re
import zipfile
from collections.abc import Iterator
from dataclasses import field

from kennfeld.base.archives import ZIP_ERRORS, find_oversized
from kennfeld.base.formatting import reason_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.section_tree import ReadDiagnostics, SectionNode, json_section, xml_section

_PACKAGE = re.compile(rb"^__MWOPC_PACKAGE_BEGIN__[ \t]*(\S*)", re.MULTILINE)
# possessive quantifiers: a line that does not match is not tried again in other ways
_PART = re.compile(rb"^__MWOPC_PART_BEGIN__[ \t]++(\S++)[ \t]*+([^\n]*+)\n", re.MULTILINE)
_END = re.compile(rb"^__MWOPC_PACKAGE_END__", re.MULTILINE)
_REMEDY = "Use a complete copy of the file."
_BASE_UNPACKED_BYTES = 50_000_000  # allowed for any file
_MAX_COMPRESSION_RATIO = 60  # model XML compresses 10 times, repetitive blocks 30 times


@dataclass
class ModelPackage:
    """Named parts of a file, without leading slash; `room` is the number of bytes that may still be unpacked."""

    diagnostics: ReadDiagnostics
    members: dict[str, zipfile.ZipInfo] = field(default_factory=dict)
    archive: zipfile.ZipFile | None = None
    texts: dict[str, bytes] = field(default_factory=dict)
    release: str = ""
    room: int = _BASE_UNPACKED_BYTES

    def __contains__(self, name: str) -> bool:
        return name in self.members or name in self.texts

    def names(self) -> Iterator[str]:
        """Yield the names of all parts."""
        yield from self.texts or self.members

    def raw(self, name: str) -> bytes | None:
        """Unpack a part, None if there is none or, with an error recorded, if it cannot be unpacked."""
        if name in self.texts:
            return self.texts[name]
        if name not in self.members or self.archive is None:
            return None
        try:
            return self._unpack(self.members[name], self.archive)
        except (*ZIP_ERRORS, OSError) as error:
            # RuntimeError: encrypted member; NotImplementedError: unknown compression method
            self.diagnostics.error(name, f"cannot be unpacked: {reason_of(error)}", _REMEDY)
            return None

    def _unpack(self, member: zipfile.ZipInfo, archive: zipfile.ZipFile) -> bytes | None:
        with archive.open(member) as stream:
            # counted while reading, because an archive may state smaller sizes than it unpacks to
            raw = stream.read(self.room + 1)
        self.room -= len(raw)
        if self.room < 0:
            message = "expands to far more data than a model of this size contains"
            self.diagnostics.error(member.filename[:80], message, _REMEDY)
            self.room = 0
            return None
        return raw

    def section(self, name: str, fold: bool = True) -> SectionNode | None:
        """Parse an XML or JSON part to a section, None if there is none or, with an error, if it is damaged."""
        raw = self.raw(name)
        if raw is None:
            return None
        if name.endswith(".json"):
            return json_section(raw, name, self.diagnostics)
        return xml_section(raw, name, self.diagnostics, fold)


def is_zip(raw: bytes) -> bool:
    """Return True if bytes start like a zip archive."""
    # the second is the begin of an empty archive
    return raw[:4] in (b"PK\3\4", b"PK\5\6")


def zip_package(raw: bytes, diagnostics: ReadDiagnostics) -> ModelPackage:
    """Open a zip archive; it has no members, with an error recorded, if it is damaged or a zip bomb."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(raw))
        members = {member.filename.lstrip("/"): member for member in archive.infolist()}
        too_much = find_oversized(archive)
    except (*ZIP_ERRORS, OSError) as error:
        remedy = "The file may be truncated: use a complete copy of the file."
        diagnostics.error("", f"is a damaged zip archive: {reason_of(error)}", remedy)
        return ModelPackage(diagnostics)
    if too_much:
        diagnostics.error("", f"expands to far more data than a model contains: {too_much}", _REMEDY)
        return ModelPackage(diagnostics)
    # one budget for all parts together
    room = max(_BASE_UNPACKED_BYTES, _MAX_COMPRESSION_RATIO * len(raw))
    return ModelPackage(diagnostics, members, archive, room=room)


def text_package(raw: bytes, diagnostics: ReadDiagnostics) -> ModelPackage:
    """Split a text package into its parts: a header line each, then XML text or base64 bytes."""
    end = _END.search(raw)
    if end is None:
        raise diagnostics.refuse("", "is truncated: the text package has no end", _REMEDY)
    release = _PACKAGE.search(raw)
    match = list(_PART.finditer(raw))
    # a part ends where the header of the next one begins
    stops = [*(part.start() for part in match[1:]), end.start()]
    texts = {}
    for part, stop in zip(match, stops, strict=False):
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
        diagnostics.warn(f"{name[:80]} cannot be decoded: {reason_of(error)}")
        return b""
