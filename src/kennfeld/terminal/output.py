"""Lines on stdout and stderr, whatever these are connected to."""

import os
import sys
from collections.abc import Iterable
from errno import EIO, EPIPE
from typing import TextIO

from kennfeld.errors import Finding, visible

__all__ = ["Painted", "complain", "say"]


class Painted(str):
    """A line with codes for colours of our own; all else in it is visible already."""

    __slots__ = ()


def say(*lines: str) -> None:
    """Print lines on stdout."""
    _print(sys.stdout, lines)


def complain(*problems: Finding | str) -> None:
    """Print problems on stderr, each in one line; the excerpt that shows the place follows below."""
    for problem in problems:
        excerpt = problem.excerpt.split("\n") if isinstance(problem, Finding) and problem.excerpt else []
        severity = problem.severity if isinstance(problem, Finding) else "error"
        line = " ".join(str(problem).split("\n"))
        _print(
            sys.stderr, [line if severity == "error" else f"{severity}: {line}", *(f"    {text}" for text in excerpt)]
        )


def _print(stream: TextIO, lines: Iterable[str]) -> None:
    """Print lines whatever they hold.

    Control characters of names become escapes, characters that the stream cannot show question marks; a reader or
    terminal that has gone is no error.
    """
    encoding = stream.encoding or "utf-8"
    shown = (line if isinstance(line, Painted) else visible(line) for line in lines)
    text = "".join(f"{line}\n" for line in shown).encode(encoding, errors="replace").decode(encoding)
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        if error.errno not in (EPIPE, EIO):
            raise
        # what is still buffered would complain once more at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
