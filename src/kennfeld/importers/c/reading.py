"""Reading of C files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.c.declarations import CFile
from kennfeld.importers.c.number_types import CType
from kennfeld.importers.c.parsing import parse_source
from kennfeld.importers.c.preprocessing import MAX_BYTES, CSource, data_file, preprocess

_MAX_NESTING: Final = 200


@dataclass(frozen=True)
class CSourceFile:
    """The declarations of a C file, and the text that they were parsed from."""

    path: Path
    source: CSource
    declarations: CFile


def read_c_file(path: Path, types: Mapping[str, CType] | None = None) -> CSourceFile:
    """Parse a C file without running a compiler; of other files, it reads those of its folder that it includes.

    `types` are the number types of the target, by default those of LP64.

    Raises:
        InputError: it cannot be read, or is not C.
    """
    text, data = _text(path), data_file(path)
    findings = Findings()
    source = preprocess(text, path, findings, _text(data) if data.is_file() else "")
    findings.finish()
    _check_nesting(source)
    return CSourceFile(path, source, parse_source(source, types))


def _text(path: Path) -> str:
    with convert_errors(path, "the file cannot be read"):
        content = path.read_bytes()
    if len(content) > MAX_BYTES or b"\0" in content:
        message = "the file is binary, not text" if b"\0" in content else f"the file has more than {MAX_BYTES} bytes"
        raise InputError.of(Location(path.name), message, "Give a source file in C.")
    return content.decode("utf-8-sig", errors="replace")


def _check_nesting(source: CSource) -> None:
    """Raise `InputError` for brackets nested so deeply that the parser would exhaust the stack."""
    depth = 0
    for number, line in enumerate(source.lines, 1):
        for character in line.text:
            depth += (character in "([{") - (character in ")]}")
            if depth > _MAX_NESTING:
                raise InputError.of(source.location(number), f"more than {_MAX_NESTING} nested brackets", "Split it.")


def unknown_function(file: CSourceFile, name: str) -> InputError:
    """Return the error that a file has no function of this name."""
    names = [*file.declarations.functions, *file.declarations.unsupported]
    listed = f"The file has {', '.join(names[:8])}." if names else "The file has no functions."
    return InputError.of(Location(file.path.name), f"no function {name}", nearest(name, names) or listed)
