"""Identification of files: the one place that decides what a file is, for commands, Python functions and the app."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from kennfeld.base.errors import InputError, Location
from kennfeld.files.file_format import FileFormat, Role
from kennfeld.files.foreign import BY_ENDING, OLE, identify_foreign, identify_package
from kennfeld.files.formats import BINARY, ZIP_ARCHIVE, certain_formats, named_format, uncertain_formats, usual_format
from kennfeld.files.head import FileHead, read_head
from kennfeld.files.recordings import CSV
from kennfeld.files.unpacking import only_member

_READABLE = (Role.RECORDING, Role.CALIBRATION)  # when compressed
_CONTAINED = (CSV, ZIP_ARCHIVE)  # formats that others resemble
_PACKAGE = 100_000_000  # bytes of an OLE package that are searched for its directory


class Identity(NamedTuple):
    """The format of a file, what the file is for, and its head."""

    format: FileFormat
    role: Role
    head: FileHead


def identify(path: str | Path, role: Role | None = None) -> Identity:
    """Return what a file is, by its content; where content does not tell, by its ending.

    A compressed file, and a ZIP archive of one file, is what is in it.

    Args:
        path: the file; the member of an archive may follow a `#`.
        role: what the file is to be used for. Of several formats that a file resembles, one that can be used so is
            chosen.

    Raises:
        InputError: there is no such file, it cannot be read, or it is of no format at all, such as a picture.

    >>> identity = identify("start.dcm")
    >>> identity.format.name, identity.role.value
    ('DCM', 'calibration')
    """
    file, member = split_address(path)
    identity = identify_head(read_head(file), role)
    is_archive = identity.format is ZIP_ARCHIVE and not identity.head.packing  # one in another is not looked into
    chosen = only_member(identity.head, member) if is_archive else ""
    if chosen:
        identity = identify_head(identity.head.head_of(chosen), role)
    head = identity.head
    if (head.packing or head.member) and identity.role not in _READABLE:
        message = f"holds {identity.format.phrase}, which is read only if it is not compressed"
        raise InputError.of(Location(file.name), message, "Unpack it first.")
    return identity


def split_address(path: str | Path) -> tuple[Path, str]:
    """Return the file of an address and what follows its `#`: the name of a sheet, or of a member of an archive."""
    file = Path(path)
    if "#" not in str(path) or file.exists():
        return file, ""
    whole, _, member = str(path).rpartition("#")
    return Path(whole), member


def identify_head(head: FileHead, role: Role | None = None) -> Identity:
    """Return what a file is by its head, as `identify` does; of a ZIP archive, not what is in it."""
    _refuse_foreign(head)
    candidates = _candidates(head)  # each costs a look at the head, so that no more are asked for than needed
    first = next(candidates)
    if role is not None:
        for known in chain((first,), candidates):
            if role in known.roles:
                return Identity(known, role, head)
    return Identity(first, first.role_of(head), head)


def _candidates(head: FileHead) -> Iterator[FileFormat]:
    """Yield the formats that a file may be of, the most likely one first.

    Any text resembles a table, and many formats are ZIP archives: a file is one of these only if nothing but a guess
    speaks for another format.
    """
    certain = next((known for known in certain_formats() if _recognises(known, head)), None)
    if certain is not None:
        yield certain
    # an empty file has no content that could tell
    named = named_format(head.ending) if head.raw.strip() else usual_format(head.ending)
    if named is not None and named is not certain:
        yield named
    is_taken = certain is not None or named is not None
    for known, is_guess in uncertain_formats():
        if not _recognises(known, head) or (known in _CONTAINED and is_taken):
            continue
        is_taken = is_taken or not is_guess
        yield known
    yield BINARY


def _recognises(known: FileFormat, head: FileHead) -> bool:
    return known.recognises is not None and known.recognises(head)


def _refuse_foreign(head: FileHead) -> None:
    """Raise `InputError` if a file is a pointer, a web page, a picture or the like."""
    content = identify_foreign(head.raw)
    # programs with these endings have a remedy of their own
    if content is not None and any(_recognises(known, head) for known in BY_ENDING):
        return
    if content is None and head.raw.startswith(OLE):
        content = identify_package(head.whole(_PACKAGE))
    if content is not None:
        raise InputError.of(Location(head.name), f"this is {content.description}", content.remedy)
