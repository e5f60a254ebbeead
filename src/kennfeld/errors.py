"""Exceptions, warnings and findings.

    KennfeldError
    ├── InputError       a file, a formula or a project is wrong; carries every finding at once
    └── ArgumentError    the Python API was called with an unusable argument (also a ValueError)

`InputWarning` is the category of Python warnings about input that is usable, but perhaps not as intended.

A fit that does not converge raises no exception: the status of its `Result` states it.
"""

import re
import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Literal

__all__ = ["ArgumentError", "Finding", "InputError", "InputWarning", "KennfeldError", "visible", "warn"]

# control characters except tab and newline, invisible characters, and those that change the writing direction
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u00ad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\U000e0000-\U000e007f]"
)


def visible(text: str) -> str:
    r"""Return the text with escapes for invisible characters and those that control a terminal.

    Names come from untrusted files: they could colour, move or overwrite terminal output. The escapes are those of
    JSON, so that JSON text keeps its meaning.

    >>> print(visible("Speed\x1b[31m"))
    Speed\u001b[31m
    """
    return _UNSEEN.sub(lambda match: _escape(match[0]), text)


def _escape(character: str) -> str:
    units = character.encode("utf-16-be")
    return "".join(f"\\u{units[k : k + 2].hex()}" for k in range(0, len(units), 2))


@dataclass(frozen=True)
class Finding:
    """One problem of an input with its location and remedy, or a remark worth knowing.

    >>> print(Finding("torque.kf line 4", "unknown parameter MapOptTorqe", "Did you mean MapOptTorque?"))
    torque.kf line 4: unknown parameter MapOptTorqe. Did you mean MapOptTorque?
    """

    place: str
    message: str
    remedy: str = ""
    excerpt: str = ""
    severity: Literal["error", "warning", "remark"] = "error"

    def __str__(self) -> str:
        message = self.message if not self.remedy or self.message.endswith((".", "?", "!")) else self.message + "."
        line = " ".join(part for part in (message, self.remedy) if part)
        return visible(f"{self.place}: {line}" if self.place else line)


class KennfeldError(Exception):
    """Base class of all exceptions that Kennfeld raises on purpose."""

    def __str__(self) -> str:
        return visible(super().__str__())


class InputError(KennfeldError):
    """Invalid input; `findings` holds all problems, in the order of the input."""

    def __init__(self, findings: Iterable[Finding]) -> None:
        self.findings = tuple(findings)
        super().__init__("\n".join(str(finding) for finding in self.findings))

    @classmethod
    def of(cls, place: str, message: str, remedy: str = "", excerpt: str = "") -> "InputError":
        """Return an error with a single finding."""
        return cls([Finding(place, message, remedy, excerpt)])


class ArgumentError(KennfeldError, ValueError):
    """An unusable argument; the text names it and its value."""


class InputWarning(UserWarning):
    """Input of the Python API that is usable, but perhaps not as intended; projects report it as a finding."""


def warn(findings: Iterable[Finding]) -> None:
    """Issue findings as Python warnings, at the line outside this package from which the call came."""
    for finding in findings:
        warnings.warn(str(finding), InputWarning, stacklevel=_frames_inside() + 1)


def _frames_inside() -> int:
    """Return the number of stack frames up to the caller that are within this package."""
    package, count = str(Path(__file__).parent), 0
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename.startswith(package):
        frame, count = frame.f_back, count + 1
    return count
