"""What two calibration files differ in, and what a merge did, as lines for a person."""

import os
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from kennfeld.calfiles import Change, Comparison, Difference
from kennfeld.terminal.output import Painted, aligned

__all__ = ["changed", "differing", "labels"]

_RED, _GREEN, _YELLOW, _PLAIN = "\x1b[31m", "\x1b[32m", "\x1b[33m", "\x1b[0m"
_LONGEST = 40  # characters of a text in a table


def labels(paths: Sequence[Path]) -> list[str]:
    """What the files are called: their names, or their paths where names repeat."""
    names = [path.name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def differing(found: Comparison, left: str, right: str, coloured: bool | None = None) -> list[str]:
    """The differences as a table, one a function where labels name theirs.

    Red is what only the first file has, green what only the second has, yellow what differs.
    """
    if found.equal:
        return [f"equal: {_counted(found.compared)} in both"]
    coloured = _shows_colours() if coloured is None else coloured
    by_function: dict[str, list[Difference]] = {}
    for one in found.differences:
        by_function.setdefault(one.function, []).append(one)
    lines: list[str] = []
    for function, differences in sorted(by_function.items(), key=lambda item: item[0] == ""):
        lines += _heading(function, differences) if any(by_function) else []
        lines += [*_table(differences, left, right, coloured), ""]
    return [*lines, _sum(found, left, right)]


def _heading(function: str, differences: Sequence[Difference]) -> list[str]:
    names = _counted(len({one.name for one in differences}))
    return [f"{f'function {function}' if function else 'without a function'}, {names}:"]


def _table(differences: Sequence[Difference], left: str, right: str, coloured: bool) -> list[str]:
    rows: list[tuple[str, ...]] = [("name", "what", left, right, "largest difference", "differ", "at")]
    rows += [_row(one, left, right) for one in differences]
    used = [i for i in range(len(rows[0])) if i < 4 or any(row[i] for row in rows[1:])]
    colours = [_colour(one) if coloured else "" for one in differences]
    return _painted(aligned([tuple(row[i] for i in used) for row in rows]), colours)


def _row(one: Difference, left: str, right: str) -> tuple[str, ...]:
    if one.aspect == "presence":
        return (one.name, f"only in {left if one.left else right}", one.left or "-", one.right or "-", "", "", "")
    if one.largest is None:
        return (one.name, one.aspect, _short(one.left), _short(one.right), "", "", "")
    share = f"{one.count} of {one.total}" if one.total > 1 else ""
    return (one.name, one.aspect, one.left, one.right, f"{one.largest:.6g}", share, one.place)


def _short(text: str) -> str:
    shown = text if text == " ".join(text.split()) and text else repr(text)
    return shown if len(shown) <= _LONGEST else f"{shown[: _LONGEST - 3]}..."


def _sum(found: Comparison, left: str, right: str) -> str:
    alone = [one for one in found.differences if one.aspect == "presence"]
    other = len({one.name for one in found.differences if one.aspect != "presence"})
    first = sum(bool(one.left) for one in alone)
    parts = [f"{other} of {_counted(found.compared)} in both differ"]
    parts += [f"{first} only in {left}"] if first else []
    parts += [f"{len(alone) - first} only in {right}"] if len(alone) > first else []
    return ", ".join(parts)


def _counted(names: int) -> str:
    return f"{names} name" if names == 1 else f"{names} names"


def _colour(one: Difference) -> str:
    if one.aspect != "presence":
        return _YELLOW
    return _RED if one.left else _GREEN


def _shows_colours() -> bool:
    """A terminal that has not asked for plain text; the old console of Windows would show the codes."""
    old = os.name == "nt" and not ({"WT_SESSION", "ANSICON", "TERM"} & os.environ.keys())
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return sys.stdout.isatty() and not old and not plain


def _painted(lines: list[str], colours: list[str]) -> list[str]:
    """The lines of a table with a colour a row; where it does not fit the terminal, a row is a block of lines."""
    if len(lines) == len(colours) + 1:
        return [lines[0], *(_paint(line, colour) for line, colour in zip(lines[1:], colours, strict=True))]
    blocks = iter(colours)
    colour, painted = next(blocks), []
    for line in lines:
        colour = colour if line else next(blocks)
        painted.append(_paint(line, colour))
    return painted


def _paint(line: str, colour: str) -> str:
    return Painted(f"{colour}{line}{_PLAIN}") if colour and line else line


def changed(changes: Iterable[Change], most: int = 50) -> list[str]:
    """What was replaced or added, a line each, and how many there are of each file."""
    made = list(changes)
    if not made:
        return ["nothing to replace and nothing to add"]
    rows = [("name", "", "by", "what")]
    rows += [(one.name, _word(one), one.source, _reasons(one)) for one in made[:most]]
    counts = Counter((one.source, _word(one)) for one in made)
    told = [f"{source}: {count} {word}" for (source, word), count in counts.items()]
    more = [f"and {len(made) - most} more"] if len(made) > most else []
    return [*aligned(rows), *more, "", *told]


def _word(one: Change) -> str:
    return "replaced" if one.replaces else "added"


def _reasons(one: Change) -> str:
    if not one.replaces:
        return ""
    told = [_reason(difference) for difference in one.differences]
    return "; ".join(told) or "description or settings"


def _reason(one: Difference) -> str:
    if one.largest is None:
        return f"{one.aspect} {_short(one.left)} -> {_short(one.right)}"
    if one.total == 1:
        return f"{one.left} -> {one.right}"
    return f"{one.count} of {one.total} {one.aspect}, the largest difference {one.largest:.6g} at {one.place}"
