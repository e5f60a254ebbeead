"""The archive of an FMU: its description, its platforms, and its files unpacked for loading."""

import atexit
import shutil
import tempfile
import zipfile
from hashlib import blake2b
from pathlib import Path, PurePosixPath

from kennfeld.base.archives import ZIP_ERRORS, find_oversized
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.fmi_platform import LIBRARY_SUFFIX, platform_folder
from kennfeld.base.formatting import reason_of
from kennfeld.base.watch_folder import watch_folder
from kennfeld.importers.fmu.description import FmuDescription
from kennfeld.importers.fmu.description_reader import LIMITS, read_description

_DESCRIPTION = "modelDescription.xml"
_MOST_FILES = 100_000


def read_archive(path: Path) -> FmuDescription:
    """Read the description of an FMU; none of its code is loaded.

    Raises:
        InputError: the file is not an FMU, is damaged, or its members would leave its folder or grow without bound.
    """
    with convert_errors(path, "cannot be read"):
        try:
            with zipfile.ZipFile(path) as archive:
                _check_members(archive, path)
                names = archive.namelist()
                if _DESCRIPTION not in names:
                    raise InputError.of(
                        Location.of_file(path), f"has no {_DESCRIPTION}", "Use an FMU of FMI 2.0 or 3.0."
                    )
                with archive.open(_DESCRIPTION) as stream:
                    # one byte more than the limit, so that the reader of XML refuses what was cut off here
                    raw = stream.read(LIMITS.size + 1)
        except ZIP_ERRORS as error:
            raise _unreadable(path, error) from None
    parts = [PurePosixPath(name).parts for name in names]
    # binaries/PLATFORM/NAME
    platforms = sorted({part[1] for part in parts if len(part) == 3 and part[0] == "binaries"})
    return read_description(raw, path.name, platforms)


def digest_of(path: Path) -> str:
    """Compute a digest of the contents of a file."""
    with convert_errors(path, "cannot be read"):
        return blake2b(path.read_bytes(), digest_size=16).hexdigest()


def read_unchanged(path: Path, digest: str) -> FmuDescription:
    """Read the description of an FMU; raises `InputError` if the file has changed since its digest was taken."""
    if digest_of(path) != digest:
        raise InputError.of(Location.of_file(path), "has changed since it was read", "Read it again.")
    return read_archive(path)


def unpack(path: Path) -> Path:
    """Unpack an FMU into a folder that is removed when the process ends, and return the folder."""
    folder = Path(tempfile.mkdtemp(prefix="kennfeld-fmu-", dir=watch_folder()))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    with convert_errors(path, "cannot be unpacked"), zipfile.ZipFile(path) as archive:
        try:
            _check_members(archive, path)
        except ZIP_ERRORS as error:
            raise _unreadable(path, error) from None
        for member in archive.infolist():
            _extract(archive, member, folder, path)
        # an FMU gets the path of its resources, which it may open although it has none
        (folder / "resources").mkdir(exist_ok=True)
    return folder


def _extract(archive: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path, path: Path) -> None:
    try:
        archive.extract(member, folder)
    except ZIP_ERRORS as error:
        # the description was readable: one damaged member is named, which tells if the transfer or the export failed
        message = f"its member {member.filename[:80]!r} is damaged: {reason_of(error)}"
        raise InputError.of(Location.of_file(path), message, "Use a complete copy.") from None


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError.of(
        Location.of_file(path), f"is not a readable ZIP archive: {reason_of(error)}", "Use a complete copy."
    )


def library_of(folder: Path, version: str, identifier: str) -> Path:
    """Return the path of the library of an unpacked FMU."""
    return folder / "binaries" / platform_folder(version) / (identifier + LIBRARY_SUFFIX)


def _check_members(archive: zipfile.ZipFile, path: Path) -> None:
    location = Location.of_file(path)
    members = archive.infolist()
    if len(members) > _MOST_FILES:
        raise InputError.of(location, f"holds {len(members)} files, more than {_MOST_FILES}", "Export the FMU again.")
    for member in members:
        parts = PurePosixPath(member.filename.replace("\\", "/"))
        if parts.is_absolute() or ".." in parts.parts or ":" in member.filename:
            message = f"the member {member.filename[:80]!r} would be unpacked outside of its folder"
            raise InputError.of(location, message, "Do not use this file.")
    oversized = find_oversized(archive)
    if oversized:
        raise InputError.of(location, oversized, "Do not use this file.")
