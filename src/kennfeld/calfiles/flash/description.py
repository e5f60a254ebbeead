"""Images as calibration files: finds the A2L file that describes an image, and reads and writes both together."""

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from kennfeld.calfiles.format import CalibrationSource, Findings, FlashOrigin, ReadResult, WriteResult
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet

if TYPE_CHECKING:
    from kennfeld.calfiles.a2l import A2l, Described


IMAGE_ENDINGS = (".hex", ".s19", ".s37", ".srec", ".mot", ".ihex", ".s28")
_INTEL_ENDINGS = (".hex", ".ihex")
_HOW_TO_SPECIFY = '--a2l FILE, or { a2l = "...", hex = "..." } in a project'
_HEAD = 65536  # characters that tell what a file is
_A2L_BLOCK = re.compile(
    r"/begin\s+(PROJECT|MODULE|MOD_PAR|MOD_COMMON|CHARACTERISTIC|AXIS_PTS|MEASUREMENT|COMPU_METHOD|COMPU_TAB|COMPU_VTAB"
    r"|COMPU_VTAB_RANGE|RECORD_LAYOUT|FUNCTION|GROUP|FRAME|UNIT|USER_RIGHTS|VARIANT_CODING|INSTANCE|TYPEDEF_\w+|BLOB"
    r"|TRANSFORMER|IF_DATA|A2ML)\b"
)
_MAX_INCLUDED_BYTES = 500_000_000  # bytes of an included file


@dataclass(frozen=True, eq=False)
class A2lFile:
    """The content of an A2L file; `remarks` lists what was skipped."""

    path: Path
    a2l: "A2l"
    remarks: tuple[Finding, ...]

    @property
    def labels(self) -> "tuple[Described, ...]":
        """Every label and group axis."""
        from kennfeld.calfiles.a2l import summarise_labels

        return summarise_labels(self.a2l)


def recognises_flash(source: CalibrationSource) -> bool:
    """Check whether a file begins like Intel HEX or S-records."""
    head = source.raw[:_HEAD].lstrip()
    if head[:1] not in (b":", b"S"):
        return False
    from kennfeld.calfiles.flash.records import recognises_image

    return recognises_image(head)


def recognises_a2l(head: str) -> bool:
    """Check whether a text begins like an A2L file or a part of one, after comments."""
    head = head[:_HEAD]
    return "ASAP2_VERSION" in head or _A2L_BLOCK.search(head) is not None


def fragment_of_a2l(head: str) -> tuple[str, str] | None:
    """Return what is wrong with a part of an A2L file, and the remedy; None for any other text."""
    head = head[:_HEAD]
    first = _A2L_BLOCK.search(head)
    if first is None or "ASAP2_VERSION" in head or first[1] in ("PROJECT", "MODULE"):
        return None
    message = f"is a fragment of an A2L file: it starts with {first[1]}, without an enclosing PROJECT and MODULE"
    return message, "Pass the A2L file that includes it."


def read_flash(source: CalibrationSource) -> ReadResult:
    """Return the parameters of an image.

    Its A2L file is `source.partner`, else the one of the same name, else the only one in its folder.

    Raises `InputError` if there is none, or if one of the two cannot be read.
    """
    from kennfeld.calfiles.a2l import read_parameters
    from kennfeld.calfiles.flash.records import read_image

    description = read_a2l(_a2l_of(source))
    findings = Findings(source.name)
    image = read_image(source.raw, source.name, findings)
    own = findings.finish()
    findings = Findings(description.path.name)
    parameters = read_parameters(description.a2l, image, findings)
    kind = f"{image.kind} with {description.path.name}"
    return ReadResult(kind, parameters, (*own, *description.remarks, *findings.finish()))


def _a2l_of(source: CalibrationSource) -> Path:
    if source.partner is not None:
        return source.partner
    folder = source.path.parent if source.path is not None else Path()
    found = sorted(one for one in folder.iterdir() if one.suffix.lower() == ".a2l") if folder.is_dir() else []
    stem = Path(source.name).stem.casefold()
    beside = [one for one in found if one.stem.casefold() == stem] or found
    if len(beside) == 1:
        return beside[0]
    message = "is an image, which requires an A2L file that describes its labels"
    if not found:
        raise InputError.of(source.name, f"{message}; its folder contains none", f"Specify it: {_HOW_TO_SPECIFY}.")
    names = ", ".join(one.name for one in found[:5])
    raise InputError.of(
        source.name, f"{message}; its folder contains {names}", f"Specify the right one: {_HOW_TO_SPECIFY}."
    )


def read_a2l(path: Path) -> A2lFile:
    """Read an A2L file and the files it includes. Raises `InputError` with all findings."""
    from kennfeld.calfiles.a2l import parse_a2l

    raw = _file_content(path)
    if raw is None:
        beside = [one.name for one in path.parent.iterdir()] if path.parent.is_dir() else []
        raise InputError.of(str(path), "A2L file not found", nearest(path.name, beside))
    findings = Findings(path.name)
    fragment = fragment_of_a2l(CalibrationSource(path.name, raw).text)
    if fragment:
        raise InputError.of(path.name, *fragment)
    a2l = parse_a2l(raw, path.name, findings, partial(_find_included, path))
    return A2lFile(path, a2l, findings.finish())


def describe_a2l(path: str | Path) -> A2lFile:
    """Read an A2L file without an image. Raises `InputError`."""
    return read_a2l(Path(path))


def _find_included(main: Path, name: str, including: Path | None) -> tuple[Path, bytes] | None:
    """Return the path and the content of a file that another one includes.

    The standard does not define its folder: that of the including file is searched first, then that of the main file.
    """
    wanted = name.strip().replace("\\", "/")
    for folder in dict.fromkeys(file.parent for file in (including or main, main)):
        content = _file_content(folder / wanted)
        if content is not None:
            return folder / wanted, content
    return None


def _file_content(path: Path) -> bytes | None:
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
    if (ending in _INTEL_ENDINGS) == (origin.image.kind == "Intel HEX"):
        return None
    known = [one for one in IMAGE_ENDINGS if (one in _INTEL_ENDINGS) == (origin.image.kind == "Intel HEX")]
    return (
        f"{origin.image.name} is {origin.image.kind}, which has other endings than {ending}",
        f"Use {', '.join(known)}.",
    )


def write_flash(parameters: ParameterSet, file: str) -> WriteResult:
    """Return the image that a set was read from, with the values of the set.

    Raises `InputError` if the set is not from an image, or for values that the control unit cannot store.
    """
    origin = parameters.origin
    wrong = unwritable(origin, Path(file).suffix.lower())
    if wrong or not isinstance(origin, FlashOrigin):
        raise InputError.of(file, *(wrong or ()))
    from kennfeld.calfiles.a2l import write_values

    findings = Findings(file)
    content = write_values(origin.a2l, origin.image, parameters, findings)
    return WriteResult(content, findings.finish())
