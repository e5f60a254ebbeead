"""Files that cannot be read: pointers, web pages, pictures and programs, and formats of other tools."""

import codecs
import re
import struct
from typing import NamedTuple

from kennfeld.files.file_format import FileFormat

_HEAD = 4096  # bytes that settle it
_POINTER = re.compile(
    rb"\Aversion https://(?:git-lfs|hawser)\.github\.com/spec/v\d[^\n]*\n(?:.*\n)*?size (\d+)\s*$", re.M
)
_ANNEX = re.compile(rb"\A(?:\.\./)*(?:\.git)?/?annex/objects/\S+-s(\d+)-", re.MULTILINE)
# atomic and possessive, so that a page full of comments is searched only once
_PAGE = re.compile(
    rb"\A\s*(?:<\?xml[^>]*>\s*)?(?:<!--(?>.*?-->)\s*+)*+<(?:!doctype\s+html|html|head|body|script|style|meta|title|div|table)\b",
    re.IGNORECASE | re.DOTALL,
)
_DRAWING = re.compile(
    rb"\A\s*(?:<\?xml[^>]*>\s*)?(?:<!(?>--.*?-->|doctype svg[^>]*+>)\s*+)*+<svg[\s>]", re.IGNORECASE | re.DOTALL
)
# characters of Latin-1 in two or four bytes, of which the others are zero
_WIDE_TEXT = re.compile(rb"(?:C\0){16}|(?:\0C){16}|(?:C\0{3}){8}|(?:\0{3}C){8}".replace(b"C", rb"[\t\n\r -~\xa0-\xff]"))
_PICTURES = (
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"\xff\xd8\xff", "JPEG"),
    (b"GIF87a", "GIF"),
    (b"GIF89a", "GIF"),
    (b"II*\0", "TIFF"),
    (b"MM\0*", "TIFF"),
    (b"8BPS", "Photoshop"),
    (b"%!PS", "PostScript"),
)
_PROGRAMS = (
    (b"MZ", "Windows"),
    (b"\x7fELF", "ELF"),
    (b"\xcf\xfa\xed\xfe", "macOS"),
    (b"\xca\xfe\xba\xbe", "macOS or Java"),
)
DATABASE = "a database of bus messages: it describes signals and holds no samples of them"
_SECRETS = (b"-----BEGIN PGP MESSAGE", b"Salted__", b"age-encryption.org/", b"\x93VeraCrypt")
_ENCRYPTED_MEMBER = 1  # flag of a ZIP archive
_NAMES = (  # streams of OLE packages, as their directory spells them
    ("WordDocument", "a Word document", ""),
    ("PowerPoint Document", "a PowerPoint presentation", ""),
    ("__properties_version1.0", "an Outlook message", "Save its attachment."),
    ("__nameid_version1.0", "an Outlook message", "Save its attachment."),
)
_WORKBOOKS = ("Workbook", "Book", "WORKBOOK", "BOOK", "EncryptedPackage")  # the last one is refused when it is opened
OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"


class ForeignContent(NamedTuple):
    """The content of a file, as `this is ...` continues, and the remedy."""

    description: str
    remedy: str


def identify_foreign(head: bytes) -> ForeignContent | None:
    """Return what a file that begins with these bytes holds if it is none that is read; None for others.

    >>> identify_foreign(b"GIF89a...").description
    'a picture (GIF)'
    """
    text = _plain_text(head[:_HEAD])
    recognitions = (_without_content, _wide_text, _git_pointer, _web_page, _picture, _video, _program, _encrypted)
    return next((content for recognise in recognitions if (content := recognise(text)) is not None), None)


def identify_package(content: bytes) -> ForeignContent | None:
    """Return what an OLE package holds if it is not a workbook; None for workbooks and other files.

    Args:
        content: all bytes of the file; the directory may be anywhere in it.
    """
    if not content.startswith(OLE):
        return None
    names = (each for each in _NAMES if each[0].encode("utf-16-le") in content)
    _, description, remedy = next(names, ("", "", ""))
    if description:
        return ForeignContent(description, remedy or "Name the recording instead, as MDF or CSV.")
    if any(f"{name}\0".encode("utf-16-le") in content for name in _WORKBOOKS):
        return None
    return ForeignContent("an OLE package without a workbook", "Save its content without encryption, as CSV or .xlsx.")


def _plain_text(head: bytes) -> bytes:
    """Return text of two bytes a character as UTF-8, without the mark of its encoding; other bytes as they are."""
    # the mark of UTF-32 begins with that of UTF-16
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return head[4:]
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return head[: len(head) // 2 * 2].decode("utf-16", "replace").encode("utf-8", "replace")
    return head.removeprefix(b"\xef\xbb\xbf")


def _without_content(head: bytes) -> ForeignContent | None:
    if head and not head.strip(b"\0"):
        return ForeignContent("a file of zero bytes, such as a copy leaves that was not finished", "Copy it again.")
    return None


def _wide_text(head: bytes) -> ForeignContent | None:
    if _WIDE_TEXT.match(head) is None:
        return None
    return ForeignContent("text in UTF-16 without a byte order mark, or in UTF-32", "Save it as UTF-8.")


def _git_pointer(head: bytes) -> ForeignContent | None:
    match = _POINTER.match(head)
    if match is not None:
        return ForeignContent(f"a Git LFS pointer ({int(match[1])} bytes were not fetched)", "Run git lfs pull.")
    match = _ANNEX.match(head)
    if match is not None:
        return ForeignContent(f"a git-annex pointer ({int(match[1])} bytes were not fetched)", "Run git annex get.")
    return None


def _web_page(head: bytes) -> ForeignContent | None:
    if _PAGE.match(head) is None:
        return None
    return ForeignContent("a web page (HTML)", "Download the file itself, or save the table as .xlsx or CSV.")


def _picture(head: bytes) -> ForeignContent | None:
    kind = next((kind for mark, kind in _PICTURES if head.startswith(mark)), "")
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        kind = "WebP"
    # text may begin with BM; a bitmap has zeros after its size, and a header of one of these sizes
    if (
        head[:2] == b"BM"
        and len(head) >= 18
        and head[6:10] == bytes(4)
        and struct.unpack("<I", head[14:18])[0] in (12, 40, 108, 124)
    ):
        kind = "bitmap"
    if _DRAWING.match(head) is not None:
        kind = "SVG"
    return ForeignContent(f"a picture ({kind})", "Name the data that it shows.") if kind else None


def _video(head: bytes) -> ForeignContent | None:
    is_video = head[4:8] == b"ftyp" or (head[:4] == b"RIFF" and head[8:12] in (b"AVI ", b"WAVE"))
    is_video = is_video or head.startswith(b"\x1aE\xdf\xa3")
    return ForeignContent("a video or sound", "Name the recording beside it.") if is_video else None


def _program(head: bytes) -> ForeignContent | None:
    # text may begin with MZ
    kind = next((kind for mark, kind in _PROGRAMS if head.startswith(mark) and b"\0" in head), "")
    return ForeignContent(f"a program or library ({kind})", "Name a file of data.") if kind else None


def _encrypted(head: bytes) -> ForeignContent | None:
    is_zip = head.startswith(b"PK\x03\x04") and len(head) > 6 and bool(head[6] & _ENCRYPTED_MEMBER)
    if is_zip or head.startswith(_SECRETS):
        return ForeignContent("an encrypted archive" if is_zip else "an encrypted file", "Unpack it first.")
    return None


def _pattern(name: str, pattern: str, description: str, remedy: str) -> FileFormat:
    """Return a format that a pattern in the first bytes tells."""
    compiled = re.compile(pattern.encode(), re.IGNORECASE | re.MULTILINE)
    return FileFormat(
        name,
        (),
        lambda head: compiled.search(_plain_text(head.raw[:_HEAD])) is not None,
        description=description,
        remedy=remedy,
    )


def _ending(ending: str, name: str, description: str, remedy: str, *, binary: bool = False) -> FileFormat:
    """Return a format that the ending tells."""
    return FileFormat(
        name,
        (ending,),
        lambda head: head.ending == ending and (head.is_binary or not binary),
        description=description,
        remedy=remedy,
    )


_UNPACK = "Unpack it first; gzip, bzip2, xz and ZIP can be read."
_NOT_READ = "which cannot be read"
_RECORDING = "Name the recording of the decoded signals instead, as MDF or CSV."
_EXPORT = "Export it from that tool as DCM (.dcm) or CDFX (.cdfx)."
_IMAGE = "Convert it to Intel HEX (.hex) or S-records (.s19), and pass the A2L file that describes it."
# formats of other tools, by their first bytes
OF_OTHER_TOOLS = (
    _pattern(
        "LIN database",
        r"\A\s*(?:/\*.*?\*/\s*)?LIN_description_file\s*;",
        f"a LIN database (LDF), {DATABASE}",
        _RECORDING,
    ),
    _pattern(
        "TDMS index",
        r"\ATDSh(?s:.)\0",
        "an index of a TDMS file, which holds no samples",
        "Name the .tdms file beside it.",
    ),
    _pattern(
        "AiM log",
        r"\A<h(?s:[A-Z]{3}.{6})>",
        "a log of AiM (.xrk)",
        "Export it as CSV from RaceStudio, or convert it to Parquet by the Python package libxrk.",
    ),
    _pattern(
        "CDF-5",
        r"\ACDF\x05",
        "a netCDF file of 64-bit data (CDF-5)",
        "Convert it: nccopy -k netCDF-4 old.nc new.nc.",
    ),
    _pattern("HDF4", r"\A\x0e\x03\x13\x01", "an HDF4 file", "Convert it to HDF5: h4toh5 old.hdf new.h5."),
    _pattern(
        "Feather 1",
        r"\AFEA1[^\t\r\n -~]",
        "a Feather file of version 1",
        "Write it again, as version 2 or as Parquet.",
    ),
    _pattern(
        "packed",
        r"\A(?:Rar!\x1a|\x04\x22\x4d\x18|\x1f\x9d)|\A(?s:.{257})ustar",
        "a compressed file or archive",
        _UNPACK,
    ),
    _pattern("packed", r"\A(?:\x28\xb5\x2f\xfd|7z\xbc\xaf)", "a compressed file", _UNPACK),
    _pattern("PDF", r"\A%PDF", "a PDF file", ""),
)
# formats of other tools, by their ending
BY_ENDING = (
    _ending(
        ".par",
        "parameter file",
        f"a parameter file (.par) that does not begin as those of CANape, {_NOT_READ}",
        _EXPORT,
    ),
    _ending(".cdm", "CDM", f"an INCA calibration data file (.cdm), {_NOT_READ}", _EXPORT),
    _ending(
        ".lab",
        "list of labels",
        "a list of labels (.lab), which contains no values",
        "Pass the calibration file with their values.",
    ),
    _ending(".bin", "memory dump", "a raw memory dump (.bin), which contains no addresses", _IMAGE, binary=True),
    _ending(".elf", "program", "a program (.elf)", _IMAGE, binary=True),
)
