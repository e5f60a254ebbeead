"""Reading of C files."""

import re
from pathlib import Path
from typing import Final

from pycparser.c_parser import CParser, ParseError

from kennfeld.errors import Findings, InputError, Location
from kennfeld.file_errors import convert_errors
from kennfeld.formatting import nearest
from kennfeld.lazy_dataclass import dataclass
from kennfeld.models.c_code.declarations import CFile, read_declarations
from kennfeld.models.c_code.preprocessing import MAX_BYTES, CSource, data_file, preprocess

_MAX_NESTING: Final = 200
_PLACE: Final = re.compile(r"(?:.*?):(\d+):(\d+): (.*)", re.DOTALL)


@dataclass(frozen=True)
class CSourceFile:
    """The declarations of a C file, and the text that they were parsed from."""

    path: Path
    source: CSource
    declarations: CFile


def read_c_file(path: Path) -> CSourceFile:
    """Parse a C file without running a compiler; of other files, it reads those of its folder that it includes.

    Raises:
        InputError: it cannot be read, or is not C.
    """
    text, data = _text(path), data_file(path)
    findings = Findings()
    source = preprocess(text, path, findings, _text(data) if data.is_file() else "")
    findings.finish()
    _check_nesting(source)
    return CSourceFile(path, source, _parsed(source))


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


def _parsed(source: CSource) -> CFile:
    parser = CParser()
    try:
        return read_declarations(parser.parse(source.text, "c"))
    except ParseError as error:
        match = _PLACE.match(str(error))
        line, column, message = (
            (int(match[1]), int(match[2]), match[3]) if match else (_line_of(parser), 0, str(error).removeprefix("c: "))
        )
        remedy = "Macros and types of included files are not known unless the files are in the folder."
        location = source.location(line, column)
        raise InputError.of(location, f"not valid C: {message[:120]}", remedy) from None
    except RecursionError:
        raise InputError.of(source.location(0), "it is nested too deeply", "Split its expressions.") from None


def _line_of(parser: CParser) -> int:
    """Return the line that a parser has reached, for errors without a place; 0 if it does not say."""
    return int(getattr(parser.clex, "_lineno", 0) or 0)


def unknown_function(file: CSourceFile, name: str) -> InputError:
    """Return the error that a file has no function of this name."""
    names = [*file.declarations.functions, *file.declarations.unsupported]
    listed = f"The file has {', '.join(names[:8])}." if names else "The file has no functions."
    return InputError.of(Location(file.path.name), f"no function {name}", nearest(name, names) or listed)
