"""The rule on where a command or the app writes: within the folder of the project, or where the user says.

A project folder may come from a stranger. Names in its files could lead elsewhere (`../../.bashrc`), and so could links
that it holds (`results/report.html -> ../../.bashrc`). Every path that is not the word of the user therefore passes
`within`, and every path that is, `named` or `below`. What lies above the folder belongs to the user, links included.
"""

import os
import stat
import unicodedata
from contextlib import suppress
from errno import EINVAL, ELOOP, EPERM
from pathlib import Path, PurePath

MAX_NAME = 200  # bytes of a name that comes from elsewhere, so that temporary files beside it have names, too
_UNSAFE = '<>:"/\\|?*'  # what a file system or a page may take for more than a name
_DEVICES = frozenset(
    ("con", "prn", "aux", "nul", "conin$", "conout$", *(f"{port}{n}" for port in ("com", "lpt") for n in "123456789"))
)
_REDIRECTS = getattr(stat, "FILE_ATTRIBUTE_REPARSE_POINT", 0)  # links and junctions of Windows


def within(folder: Path, *names: str | PurePath) -> Path:
    """Return the path of a file or folder to write within a folder; it need not exist.

    Args:
        folder: A folder that the user named; it may be a link.
        names: Relative paths below it, with `/` or the separator of the system.

    Raises:
        OSError: The path leaves the folder, a name of it is not plain, or a part of it is a symbolic link.

    >>> within(Path("project"), "results/report.html").as_posix()
    'project/results/report.html'
    >>> within(Path("project"), "../report.html")
    Traceback (most recent call last):
    PermissionError: [Errno 1] it is outside of the folder project: '../report.html'
    """
    path = folder
    for part in PurePath(*names).parts:
        # an anchor is that of an absolute path, or a drive of Windows
        if part == os.pardir or PurePath(part).anchor:
            raise OSError(EPERM, f"it is outside of the folder {folder.name or folder}", str(PurePath(*names)))
        if not is_plain_name(part):
            raise OSError(EINVAL, f"{part!r} is not a name for a file", str(PurePath(*names)))
        path = named(path / part)
    return path


def named(path: Path) -> Path:
    """Return a path to write that the user named.

    Raises:
        OSError: It is a symbolic link.
    """
    if is_link(path):
        try:
            target = f" to {path.readlink()}"
        except OSError:
            target = ""
        raise OSError(ELOOP, f"it is a symbolic link{target}, and nothing is written through links", str(path))
    return path


def below(folder: Path, path: Path) -> Path:
    """Return a path to write that the user named, perhaps within a folder whose contents are not the user's.

    Outside of the folder, links are the user's own.

    Raises:
        OSError: The path is within the folder, and reached by a symbolic link.
    """
    names = _names_below(folder, path)
    if names is not None:
        within(folder, names)
    return path


def is_below(folder: Path, path: Path) -> bool:
    """Return True if a path is within a folder; links above the folder do not count, and those in it are not followed.

    >>> is_below(Path(), Path("results")), is_below(Path(), Path("..") / "results")
    (True, False)
    """
    return _names_below(folder, path) is not None


def _names_below(folder: Path, path: Path) -> PurePath | None:
    """Return the names that lead from a folder to a path; None if it is not within the folder."""
    whole = path.absolute()
    for ancestor in whole.parents:  # the deepest first, as each `..` leads where the system says
        with suppress(OSError):
            if ancestor.samefile(folder):
                names = whole.relative_to(ancestor)
                return None if os.pardir in names.parts else names
    return None


def is_link(path: Path) -> bool:
    """Return True for a symbolic link, or a junction of Windows, also if it leads nowhere."""
    try:
        status = path.lstat()
    except (OSError, ValueError):
        return False
    return stat.S_ISLNK(status.st_mode) or bool(getattr(status, "st_file_attributes", 0) & _REDIRECTS)


def is_plain_name(name: str) -> bool:
    r"""Return True if a name is one file of a folder, and looks like what it is.

    >>> [is_plain_name(name) for name in ("report.html", ".kennfeld", "..", "a/b", "a\\b", "gpj\u202ecsv", "")]
    [True, True, False, False, False, False, False]
    """
    unsafe = _UNSAFE if os.name == "nt" else "/\\"
    if name in ("", os.curdir, os.pardir) or any(letter in unsafe or _is_unseen(letter) for letter in name):
        return False
    # Windows drops dots and blanks at the end
    return os.name != "nt" or not (_is_device(name) or name.endswith((".", " ")))


def file_name(written: str) -> str:
    r"""Strip a name of a file of its folders, however a text separates them.

    >>> file_name("data\\engine.sldd"), file_name("data/engine.sldd")
    ('engine.sldd', 'engine.sldd')
    """
    return written.replace("\\", "/").rpartition("/")[2]


def plain_name(name: str) -> str:
    """Return a file name without a folder, and without characters that a file system or a page may take for more.

    >>> plain_name("../../a:b?.csv"), plain_name("CON.csv"), plain_name("gpj\u202ecsv.exe")
    ('a_b_.csv', '_CON.csv', 'gpj_csv.exe')
    """
    plain = "".join("_" if letter in _UNSAFE or _is_unseen(letter) else letter for letter in file_name(name))
    # a dot at the beginning would hide the file; Windows drops dots and blanks at the end
    plain = _last_bytes(plain, MAX_NAME).strip(". ") or "file"
    return f"_{plain}" if _is_device(plain) else plain


def _is_device(name: str) -> bool:
    # a device with any ending is still the device
    return name.partition(".")[0].rstrip(" ").casefold() in _DEVICES


def _is_unseen(letter: str) -> bool:
    """Return True for what is invisible, controls a terminal or the direction of writing, or cannot be encoded."""
    return unicodedata.category(letter) in ("Cc", "Cf", "Cs", "Zl", "Zp")


def _last_bytes(name: str, most: int) -> str:
    """Return the end of a name, with its extension, in at most so many bytes."""
    while len(name.encode("utf-8")) > most:
        name = name[1:]
    return name
