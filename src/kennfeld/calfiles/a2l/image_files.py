"""Images as calibration files: finds the A2L file that describes an image, and reads and writes both together."""

from functools import partial
from pathlib import Path

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import nearest_file
from kennfeld.base.file_state import note_opened
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.objects import A2l, Described, summarise_labels
from kennfeld.calfiles.a2l.origin import FlashOrigin
from kennfeld.calfiles.format import CalibrationSource, FileFindings, ReadResult, WriteResult
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.files.descriptions import fragment_of_a2l

_INTEL_ENDINGS = (".hex", ".ihex")
_HOW_TO_SPECIFY = '--a2l FILE, or { a2l = "...", hex = "..." } in a project'
_MAX_INCLUDED_BYTES = 500_000_000  # bytes of an included file


@dataclass(frozen=True, eq=False)
class A2lFile:
    """The content of an A2L file; `findings` list what was skipped."""

    path: Path
    a2l: A2l
    findings: tuple[Finding, ...]

    @property
    def labels(self) -> tuple[Described, ...]:
        """Every label and group axis."""
        return summarise_labels(self.a2l)


def read_flash(source: CalibrationSource) -> ReadResult:
    """Return the parameters of an image.

    Its A2L file is `source.partner`, else the one of the same name, else the only one in its folder.

    Raises `InputError` if there is none, or if one of the two cannot be read.
    """
    from kennfeld.calfiles.a2l.reader import read_parameters
    from kennfeld.calfiles.flash.records import read_image

    description = describe_a2l(_a2l_of(source))
    image_findings, findings = FileFindings(source.name), FileFindings(description.path.name)
    image = read_image(source.raw, source.name, image_findings)
    own = image_findings.finish()
    parameters = read_parameters(description.a2l, image, findings)
    kind = f"{image.kind} with {description.path.name}"
    return ReadResult(kind, parameters, (*own, *description.findings, *findings.finish()))


def _a2l_of(source: CalibrationSource) -> Path:
    if source.partner is not None:
        return source.partner
    folder = source.path.parent if source.path is not None else Path()
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".a2l") if folder.is_dir() else []
    stem = Path(source.name).stem.casefold()
    candidates = [file for file in files if file.stem.casefold() == stem] or files
    if len(candidates) == 1:
        return candidates[0]
    names = join_names([file.name for file in files], 5) or "none"
    message = f"is an image, which requires an A2L file that describes its labels; its folder contains {names}"
    remedy = f"Specify {'the right one' if files else 'it'}: {_HOW_TO_SPECIFY}."
    raise InputError.of(Location(source.name), message, remedy)


def describe_a2l(path: str | Path) -> A2lFile:
    """Read an A2L file, without an image, and the files it includes. Raises `InputError` with all findings."""
    from kennfeld.calfiles.a2l.parser import parse_a2l

    path = Path(path)
    raw = _file_content(path)
    if raw is None:
        raise InputError.of(Location.of_file(path), "A2L file not found", nearest_file(path))
    fragment = fragment_of_a2l(CalibrationSource(path.name, raw).text)
    if fragment:
        raise InputError.of(Location(path.name), *fragment)
    findings = FileFindings(path.name)
    a2l = parse_a2l(raw, path.name, findings, partial(_find_included, path))
    return A2lFile(path, a2l, findings.finish())


def _find_included(main: Path, name: str, including: Path | None) -> tuple[Path, bytes] | None:
    """Return the path and the content of a file that another one includes.

    The standard does not define its folder: that of the including file is searched first, then that of the main file.
    """
    # paths are those of Windows in most files
    path = name.strip().replace("\\", "/")
    for folder in dict.fromkeys(file.parent for file in (including or main, main)):
        content = _file_content(folder / path)
        if content is not None:
            return folder / path, content
    return None


def _file_content(path: Path) -> bytes | None:
    note_opened(path)
    try:
        if not path.is_file() or path.stat().st_size > _MAX_INCLUDED_BYTES:
            return None
        return path.read_bytes()
    except (OSError, ValueError):
        return None


def unwritable(origin: object, ending: str) -> tuple[str, str] | None:
    """Return why an image of an ending cannot be written, and the remedy; None if it can."""
    if not isinstance(origin, FlashOrigin):
        message = "writing an image requires an existing image to modify, but none is given"
        return message, "Read the parameters from an image, or specify one: kennfeld convert IN OUT --image FILE."
    is_intel = origin.image.kind == "Intel HEX"
    # the records of the image are changed in place, so their format stays
    if (ending in _INTEL_ENDINGS) == is_intel:
        return None
    fitting = [known for known in IMAGE_ENDINGS if (known in _INTEL_ENDINGS) == is_intel]
    message = f"{origin.image.name} is {origin.image.kind}, which has other endings than {ending}"
    return message, f"Use {', '.join(fitting)}."


def write_flash(parameters: ParameterSet, file: str) -> WriteResult:
    """Return the image that a set was read from, with the values of the set.

    Raises `InputError` if the set is not from an image, or for values that the control unit cannot store.
    """
    origin = parameters.origin
    reason = unwritable(origin, Path(file).suffix.lower())
    if reason or not isinstance(origin, FlashOrigin):
        raise InputError.of(Location(file), *(reason or ()))
    from kennfeld.calfiles.a2l.writer import write_values

    findings = FileFindings(file)
    content = write_values(origin.a2l, origin.image, parameters, findings)
    return WriteResult(content, findings.finish())
