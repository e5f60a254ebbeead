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
from kennfeld.models.c_code.preprocessing import preprocess

_MAX_BYTES: Final = 2_000_000
_MAX_NESTING: Final = 200
_PLACE: Final = re.compile(r"(?:.*?):(\d+):(\d+): (.*)", re.DOTALL)


@dataclass(frozen=True)
class ParsedFile:
    """The declarations of a C file, and the files that it includes in quotes."""

    path: Path
    text: str
    declarations: CFile
    included: tuple[str, ...]


def read_c_file(path: Path) -> ParsedFile:
    """Parse a C file without running a compiler or reading other files.

    Raises:
        InputError: it cannot be read, or is not C.
    """
    with convert_errors(path, "the file cannot be read"):
        content = path.read_bytes()
    if len(content) > _MAX_BYTES or b"\0" in content:
        message = "the file is binary, not text" if b"\0" in content else f"the file has more than {_MAX_BYTES} bytes"
        raise InputError.of(Location(path.name), message, "Give a source file in C.")
    text = content.decode("utf-8-sig", errors="replace")
    findings = Findings()
    source = preprocess(text, path.name, findings)
    findings.finish()
    _check_nesting(source.text, path.name)
    return ParsedFile(path, text, _parsed(source.text, path.name), source.included)


def _check_nesting(text: str, file: str) -> None:
    """Raise `InputError` for brackets nested so deeply that the parser would exhaust the stack."""
    depth, line = 0, -1
    for character in text:
        line += character == "\n"
        depth += (character in "([{") - (character in ")]}")
        if depth > _MAX_NESTING:
            raise InputError.of(
                Location(file, max(line - 1, 1)), f"more than {_MAX_NESTING} nested brackets", "Split it."
            )


def _parsed(text: str, file: str) -> CFile:
    parser = CParser()
    try:
        return read_declarations(parser.parse(text, file))
    except ParseError as error:
        match = _PLACE.match(str(error))
        line, column, message = (
            (int(match[1]), int(match[2]), match[3])
            if match
            else (_line_of(parser), 0, str(error).removeprefix(f"{file}: "))
        )
        remedy = "Macros and types of included files are not known; define them in this file."
        raise InputError.of(Location(file, line, column=column), f"not valid C: {message[:120]}", remedy) from None
    except RecursionError:
        raise InputError.of(Location(file), "it is nested too deeply", "Split its expressions.") from None


def _line_of(parser: CParser) -> int:
    """Return the line that a parser has reached, for errors without a place; 0 if it does not say."""
    return int(getattr(parser.clex, "_lineno", 0) or 0)


def unknown_function(file: ParsedFile, name: str) -> InputError:
    """Return the error that a file has no function of this name."""
    names = [*file.declarations.functions, *file.declarations.unsupported]
    listed = f"The file has {', '.join(names[:8])}." if names else "The file has no functions."
    return InputError.of(Location(file.path.name), f"no function {name}", nearest(name, names) or listed)
