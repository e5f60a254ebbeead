"""Exceptions, warnings and findings.

    KennfeldError
    ├── InputError       a file, a formula or a project is wrong; carries every finding at once
    └── ArgumentError    the Python API was called with an unusable argument (also a ValueError)

`InputWarning` is the category of Python warnings about input that is usable, but perhaps not as intended.

A fit that does not converge raises no exception: the status of its `Result` states it.
"""

import json
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, field, replace
from pathlib import Path
from types import FrameType
from typing import Any, Literal, TypeVar

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay

Severity = Literal["error", "warning", "remark"]
Keys = tuple[str | int, ...]  # of a file in TOML; entries of a list count from 1
_Value = TypeVar("_Value")  # Python 3.11

# control characters except tab and newline, invisible characters, and those that change the writing direction
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u00ad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\U000e0000-\U000e007f]"
)


_MAX_TITLE = 40  # of the value that a fix sets


def is_plain(text: str) -> bool:
    """Return True if a text certainly has nothing that `visible` escapes, found faster than by a search."""
    return text.isascii() and text.isprintable()


def visible(text: str) -> str:
    r"""Return the text with escapes for invisible characters and those that control a terminal.

    Names come from untrusted files: they could colour, move or overwrite terminal output. The escapes are those of
    JSON, so that JSON text keeps its meaning.

    >>> print(visible("Speed\x1b[31m"))
    Speed\u001b[31m
    """
    if is_plain(text):
        return text
    return _UNSEEN.sub(lambda match: _escape(match[0]), text)


def _escape(character: str) -> str:
    # two units for characters beyond 16 bits, as in JSON
    units = character.encode("utf-16-be")
    return "".join(f"\\u{units[k : k + 2].hex()}" for k in range(0, len(units), 2))


@dataclass(frozen=True)
class Location:
    """A place in an input.

    Attributes:
        file: name of the file or dataset, or the argument of a call.
        line: line of the file from 1 on; 0 if the location is the file as a whole, or has no lines.
        path: place within the file, such as a section and key, a label or a block; may be empty.
        column: column from 1 on of the line, or of the text at the path; 0 if the location is all of it.
        keys: keys of the table of a project file that the location is within; empty elsewhere.

    >>> print(Location("engine.dcm", 12, "MapX"), "|", Location("kennfeld.toml", 4, "[model] step"))
    engine.dcm line 12 (MapX) | kennfeld.toml line 4 [model] step
    >>> print(Location("engine.slx", path="Controller/Gain"), "|", Location("torque.kf", 4, column=9))
    engine.slx Controller/Gain | torque.kf line 4, column 9
    """

    file: str = ""
    line: int = 0
    path: str = ""
    column: int = 0
    keys: Keys = field(default=(), compare=False, repr=False)

    @classmethod
    def of_file(cls, path: Path | str) -> "Location":
        """Return the location of a file, named from the present folder if it is reached from there."""
        if Path(path).is_absolute():
            with suppress(OSError, ValueError):
                path = Path(path).relative_to(Path.cwd())
        return cls(str(path))

    def within(self, path: str) -> "Location":
        """Return the location of a part: `path` is appended to the own path."""
        return replace(self, path=f"{self.path} {path}".strip())

    def __str__(self) -> str:
        line = f"line {self.line}" if self.line else ""
        # a section such as [model] has brackets of its own
        path = f"({self.path})" if line and self.path and not self.path.startswith("[") else self.path
        place = " ".join(part for part in (self.file, line, path) if part)
        return f"{place}, column {self.column}" if self.column else place


@dataclass(frozen=True)
class Fix:
    """A change of the project file that solves a problem, as the app offers it on a button.

    Attributes:
        title: the change in a few words.
        changes: path and value of each key; None removes one.
        options: values for the last of the keys to choose from, in place of the one that it has; empty if it is known.

    >>> Fix.set(("model", "step"), 0.1).title, Fix.remove(("dataset", 2)).title
    ('Set step = 0.1', 'Remove dataset 2')
    """

    title: str
    changes: tuple[tuple[Keys, Any], ...]
    options: tuple[str, ...] = ()

    @classmethod
    def set(cls, keys: Keys, value: Any) -> "Fix":
        """Return the fix that sets a key to a text, a number, a flag or a list of them."""
        return cls(f"Set {_key_name(keys)} = {_value_text(value)}", ((keys, value),))

    @classmethod
    def remove(cls, keys: Keys) -> "Fix":
        """Return the fix that removes a key, a section or an entry of a list."""
        return cls(f"Remove {_key_name(keys)}", ((keys, None),))

    @classmethod
    def choose(cls, keys: Keys, options: Iterable[str]) -> "Fix":
        """Return the fix that sets a key to one of several texts."""
        return cls(f"Set {_key_name(keys)}", ((keys, ""),), tuple(options))

    @classmethod
    def exchange(cls, title: str, keys: Keys, entries: Iterable[str], old: str, new: str = "") -> "Fix":
        """Return the fix that puts another text in the place of one of a list, or none; an empty list is removed."""
        changed = [new if entry == old else entry for entry in entries if entry != old or new]
        return cls(title, ((keys, changed or None),))

    @classmethod
    def rename(cls, keys: Keys, name: str, value: Any) -> "Fix":
        """Return the fix that gives a key another name, with the value that it has."""
        return cls(f"Write {name}", (((*keys[:-1], name), value), (keys, None)))


def choices(keys: Keys, options: Sequence[str], *, removable: bool = False) -> list[Fix]:
    """Return the fixes of a key that names something missing: the only alternative, or a choice; and its removal."""
    known = [Fix.set(keys, options[0])] if len(options) == 1 else [Fix.choose(keys, options)] if options else []
    return [*known, Fix.remove(keys)] if removable else known


def _key_name(keys: Keys) -> str:
    return " ".join(map(str, keys[-2:] if isinstance(keys[-1], int) else keys[-1:]))


def _value_text(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _MAX_TITLE else f"{text[: _MAX_TITLE - 3]}..."


@dataclass(frozen=True)
class Finding(NotebookDisplay):
    """One problem of an input with its location and remedy, or a remark: something worth knowing.

    Attributes:
        location: file or argument, line and place within it.
        message: the problem.
        remedy: what to do about it; may be empty.
        excerpt: the text that the location shows; may be empty.
        severity: an `error` means that the input cannot be used, a `warning` that something should be checked, and a
            `remark` states what was done with the input.
        fixes: changes of the project file that solve the problem, each of them alone.

    >>> print(Finding(Location("torque.kf", 4), "unknown parameter MapOptTorqe", "Did you mean MapOptTorque?"))
    torque.kf line 4: unknown parameter MapOptTorqe. Did you mean MapOptTorque?
    """

    location: Location
    message: str
    remedy: str = ""
    excerpt: str = ""
    _: KW_ONLY
    severity: Severity = "error"
    fixes: tuple[Fix, ...] = field(default=(), compare=False, repr=False)

    def __str__(self) -> str:
        message = self.message if not self.remedy or self.message.endswith((".", "?", "!")) else self.message + "."
        line = " ".join(part for part in (message, self.remedy) if part)
        location = str(self.location)
        return visible(f"{location}: {line}" if location else line)


class FindingList(list[Finding], NotebookDisplay):
    """A list of findings, which notebooks display as a table."""


class Findings(NotebookDisplay):
    """Collects the findings of an input, so that all of them are reported at once.

    >>> findings = Findings()
    >>> findings.warning(Location("engine.dcm", 30, "MapX"), "has no unit")
    >>> findings.error(Location("engine.dcm", 12, "MapY"), "has 3 values, expected 4")
    >>> print(*findings, sep=" | ")
    engine.dcm line 12 (MapY): has 3 values, expected 4 | engine.dcm line 30 (MapX): has no unit
    """

    def __init__(self, findings: Iterable[Finding] = ()) -> None:
        self._findings = list(findings)

    def error(
        self, location: Location, message: str, remedy: str = "", excerpt: str = "", fixes: Iterable[Fix] = ()
    ) -> None:
        """Add an error; `excerpt` is the text that the location shows."""
        self.add(Finding(location, message, remedy, excerpt, fixes=tuple(fixes)))

    def warning(self, location: Location, message: str, remedy: str = "", fixes: Iterable[Fix] = ()) -> None:
        """Add a warning."""
        self.add(Finding(location, message, remedy, severity="warning", fixes=tuple(fixes)))

    def remark(self, location: Location, message: str, remedy: str = "") -> None:
        """Add a remark."""
        self.add(Finding(location, message, remedy, severity="remark"))

    def add(self, *findings: Finding) -> None:
        """Add findings that exist already."""
        self._findings += findings

    def offer(self, fix: Fix, begin: int) -> None:
        """Add a fix to those findings from number `begin` on that have none."""
        for number in range(begin, len(self._findings)):
            if not self._findings[number].fixes:
                self._findings[number] = replace(self._findings[number], fixes=(fix,))

    @property
    def has_errors(self) -> bool:
        """True if at least one finding is an error."""
        return any(finding.severity == "error" for finding in self._findings)

    def finish(self) -> tuple[Finding, ...]:
        """Return all findings, those of a file in the order of its lines; raise `InputError` if one is an error."""
        if self.has_errors:
            raise InputError(finding for finding in self if finding.severity == "error")
        return tuple(self)

    def __iter__(self) -> Iterator[Finding]:
        return iter(sorted(self._findings, key=_line))

    def __len__(self) -> int:
        return len(self._findings)


def _line(finding: Finding) -> int:
    return finding.location.line


class KennfeldError(Exception):
    """Base class of all exceptions that Kennfeld raises on purpose.

    >>> issubclass(InputError, KennfeldError), issubclass(ArgumentError, KennfeldError)
    (True, True)
    """

    def __str__(self) -> str:
        return visible(super().__str__())


class InputError(KennfeldError):
    """Invalid input; `findings` holds all problems, in the order of the input.

    >>> from kennfeld import formula
    >>> try:
    ...     formula("y = Gain(u")
    ... except InputError as error:
    ...     print(error.findings[0])
    formula line 1, column 9: unclosed parenthesis
    """

    def __init__(self, findings: Iterable[Finding]) -> None:
        self.findings = tuple(findings)
        super().__init__("\n".join(str(finding) for finding in self.findings))

    def __reduce__(self) -> "tuple[type[InputError], tuple[tuple[Finding, ...]]]":
        return type(self), (self.findings,)  # for other processes; those of an exception are its text

    @classmethod
    def of(
        cls, location: Location, message: str, remedy: str = "", excerpt: str = "", fixes: Iterable[Fix] = ()
    ) -> "InputError":
        """Return an error with a single finding."""
        return cls([Finding(location, message, remedy, excerpt, fixes=tuple(fixes))])


class ArgumentError(KennfeldError, ValueError):
    """An unusable argument; the text names it and its value. It is also a `ValueError`.

    >>> from kennfeld import Options
    >>> try:
    ...     Options(starts=0)
    ... except ArgumentError as error:
    ...     print(error)
    starts must be an integer >= 1, got 0
    """


class InputWarning(UserWarning):
    """Input of the Python API that is usable, but perhaps not as intended; projects report it as a finding.

    >>> import warnings
    >>> from kennfeld import simulate
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     nodes = simulate("y = 2 * x", {"x": [1.0, float("inf")]}, {})
    >>> print(caught[0].message)
    dataset data, channel x: 1 of 2 values is infinite and treated as missing
    """


for _public in (ArgumentError, InputError, InputWarning, KennfeldError):
    _public.__module__ = "kennfeld"  # from where users import them, and what tracebacks show


def warn(findings: Iterable[Finding]) -> None:
    """Issue findings as Python warnings, at the line outside this package from which the call came."""
    for finding in findings:
        warnings.warn(str(finding), InputWarning, stacklevel=_frames_inside() + 1)


def warn_deprecated(message: str) -> None:
    """Issue a `DeprecationWarning`, at the line outside this package from which the call came.

    Args:
        message: what is deprecated, and what to write in its place.
    """
    warnings.warn(message, DeprecationWarning, stacklevel=_frames_inside() + 1)


def renamed(value: _Value, former: _Value | None, name: str, former_name: str) -> _Value:
    """Return the value of an argument, which may be stated by its former name, with a `DeprecationWarning`."""
    if former is None:
        return value
    warn_deprecated(f"the argument {former_name} is now called {name}: write {name}=...")
    return former


def repeat_warnings(messages: Iterable[Warning | str]) -> None:
    """Issue warnings of another process, at the line outside this package from which the call came."""
    for message in messages:
        warnings.warn(message, stacklevel=_frames_inside() + 1)


def _frames_inside() -> int:
    """Return the number of stack frames up to the caller that are within this package."""
    package, count = str(Path(__file__).parents[1]), 0
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename.startswith(package):
        frame, count = frame.f_back, count + 1
    return count
