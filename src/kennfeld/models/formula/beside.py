"""The data-driven models that lie beside a formula text and that it calls."""

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.models.formula.names import walk
from kennfeld.models.formula.parser import parse
from kennfeld.models.formula.source import Source
from kennfeld.models.formula.syntax import Call, Declaration, Definition, Function

if TYPE_CHECKING:  # most texts call none
    from kennfeld.surrogate import Surrogate

__all__ = ["surrogates_beside"]


def surrogates_beside(path: str | Path) -> "tuple[Surrogate, ...]":
    """The surrogates in files NAME.json beside a text, where the text calls NAME and does not declare it as a table.

    A project says itself where its surrogates are; this is for a text alone. Each has the name of its file. Raises
    `InputError` where such a file is damaged; a text that cannot be read calls none.
    """
    path = Path(path)
    found = [file for name in _called(path) if (file := _file(path, name)) is not None]
    if not found:
        return ()
    from dataclasses import replace

    from kennfeld.surrogate import read_surrogate

    return tuple(replace(read_surrogate(file), name=file.stem) for file in found)


def _called(path: Path) -> Collection[str]:
    """What the text calls and defines nowhere."""
    try:
        source = Source.of_text(path.name, path.read_text("utf-8-sig", errors="replace"))
    except OSError:
        return ()
    statements = parse(source)
    own = {one.at.name for one in statements if isinstance(one, Declaration | Function | Definition)}
    written = [one.value for one in statements if isinstance(one, Definition | Function) and one.value is not None]
    called = dict.fromkeys(part.name for value in written for part in walk(value) if isinstance(part, Call))
    return [name for name in called if name not in own and name not in FUNCTIONS]


def _file(path: Path, name: str) -> Path | None:
    """The file of a surrogate of that name, None where there is none; a calibration file is none."""
    file = path.with_name(f"{name}.json") if Path(name).name == name else path
    if file == path or not file.is_file():
        return None
    from kennfeld.surrogate import recognises_surrogate

    try:
        with file.open("rb") as stream:
            head = stream.read(200).decode("utf-8", errors="replace")
    except OSError:
        return None
    return file if recognises_surrogate(head) else None
