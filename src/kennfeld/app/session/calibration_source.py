"""Sets of values that can be compared: the present ones, the start, a run, or a calibration file of the folder."""

from collections.abc import Collection, Iterator
from pathlib import Path

from kennfeld.app.folders import confined
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError, Finding, InputError
from kennfeld.base.file_state import while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles import endings, read, read_several, recognise
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.files.calibrations import IMAGE_ENDINGS, JSON
from kennfeld.files.descriptions import A2L
from kennfeld.files.file_format import Role
from kennfeld.files.formats import endings_of
from kennfeld.project.checkpoints import FOLDER as SAVES

MAX_FILES = 300
MAX_DEPTH = 3  # folders below that of the project
MAX_AMBIGUOUS = 20_000_000  # bytes of a file that may be a recording, too
_RECORDINGS = endings_of(Role.RECORDING)
[_A2L] = A2L.endings


@dataclass(frozen=True)
class ValueSource:
    """A set of values, its name, and findings on what was skipped when it was read."""

    label: str
    parameters: ParameterSet
    findings: tuple[Finding, ...] = ()
    path: Path | None = None
    a2l: Path | None = None


@dataclass(frozen=True)
class SourceName:
    """A set of values as a page names it.

    Attributes:
        from_: "now", "start", the number of a run, or "file".
        file: a file of the folder.
        a2l: the A2L file of an image, if it is known.
    """

    from_: str | int = "now"
    file: str = ""
    a2l: str | None = None


def source_of(session: Session, name: SourceName) -> ValueSource:
    """Return the set that a page names.

    Raises:
        ArgumentError: it is not a file of the folder, or there is no such run.
        InputError: the file cannot be read.
    """
    origin = str(name.from_)
    if origin == "file":
        return _file_source(session, name.file, name.a2l or "")
    project, view = session.project, session.require_view()
    surrogates = project.surrogates if project is not None else ()
    if origin in ("now", "start"):
        evaluation = view.now if origin == "now" else view.start
        return ValueSource(origin, evaluation.parameters.without(surrogates))
    if not (origin.isdigit() and 1 <= int(origin) <= len(session.runs)):
        raise ArgumentError(f"there is no run {origin[:20]}")
    run = session.runs[int(origin) - 1]
    return ValueSource(f"run {origin}", run.result.parameters.without(surrogates))


def _file_source(session: Session, name: str, a2l: str) -> ValueSource:
    folder = session.path.parent
    path, description = confined(folder, name), confined(folder, a2l) if a2l else None
    parameters, findings = _read(path, description)
    return ValueSource(name, parameters, findings, path, description)


@while_unchanged(8)
def _read(path: Path, a2l: Path | None) -> tuple[ParameterSet, tuple[Finding, ...]]:
    [parameters], findings = read_several([path], a2l)
    return parameters if parameters.origin is not None else parameters.from_origin(path), findings


def calibration_files(folder: Path) -> list[tuple[str, str]]:
    """Return path and format of the calibration files of a folder, and of its A2L files with the format `A2L`."""
    rows = ((path.relative_to(folder).as_posix(), _format(path)) for path in _candidates(folder, 0))
    return [row for row in rows if row[1]][:MAX_FILES]


def _candidates(folder: Path, depth: int) -> Iterator[Path]:
    """Yield files with the ending of a calibration file; links and hidden folders are not followed."""
    try:
        entries = sorted(folder.iterdir(), key=lambda path: (path.is_dir(), path.name.casefold()))
    except OSError:
        return
    known = (*endings(), _A2L)
    for path in entries:
        if path.name.startswith(".") or path.is_symlink():
            continue
        if path.is_file() and path.suffix.lower() in known:
            yield path
        elif path.is_dir() and depth < MAX_DEPTH and path.name != SAVES:
            yield from _candidates(path, depth + 1)


@while_unchanged(1024)
def _format(path: Path) -> str:
    """Return the format of a file as the page shows it; empty if it holds no calibration."""
    ending = path.suffix.lower()
    try:
        if ending in _RECORDINGS and path.stat().st_size > MAX_AMBIGUOUS:
            return ""
        if recognise(path) == JSON.name and not read(path):
            return ""  # settings of another kind
    except (InputError, OSError):
        return ""
    return ending[1:].upper() if ending == _A2L or recognise(path) else ""


def is_image(name: str) -> bool:
    """Return True for the ending of an image, which needs an A2L file."""
    return name.lower().endswith(IMAGE_ENDINGS)


def initial_image(session: Session) -> tuple[Path, Path | None] | None:
    """Return the image among the initial files, with its A2L file if the project names one."""
    if session.project is None:
        return None
    calibration, folder = session.project.file.calibration, session.path.parent
    images = [name for name in calibration.files if is_image(name)]
    if not images:
        return None
    description = calibration.descriptions.get(images[-1])
    return folder / images[-1], folder / description if description else None


def part_of(parameters: ParameterSet, names: Collection[str]) -> ParameterSet:
    """Return the named parameters, texts and group axes of a set, with the group axes of these parameters."""
    members = [member for member in parameters.parameters if member.name in names]
    used = {axis.name for member in members for axis in member.axes}
    return ParameterSet(
        members,
        [text for text in parameters.texts if text.name in names],
        [axis for axis in parameters.axes if axis.name in names or axis.name in used],
        [item for item in parameters.others if item.name in names],
        origin=parameters.origin,
    )
