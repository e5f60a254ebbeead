"""Lines on the differences between two calibration files, and on the changes of a merge."""

import os
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from kennfeld.base.formatting import count_more, count_noun
from kennfeld.calfiles import Change, Comparison, Difference
from kennfeld.terminal.output import Painted, align

_RED, _GREEN, _YELLOW, _PLAIN = "\x1b[31m", "\x1b[32m", "\x1b[33m", "\x1b[0m"
_MAX_TEXT = 40  # characters in a cell


def file_labels(paths: Sequence[Path]) -> list[str]:
    """Return the names of files, or their paths if names repeat."""
    names = [path.name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def difference_lines(comparison: Comparison, left: str, right: str, coloured: bool | None = None) -> list[str]:
    """Return the differences as a table, or a table for each function if labels name their functions.

    Red: only in the first file; green: only in the second; yellow: different in both.
    """
    if comparison.equal:
        return [f"equal: {count_noun(comparison.compared, 'name')} in both"]
    coloured = _shows_colours() if coloured is None else coloured
    by_function: dict[str, list[Difference]] = {}
    for difference in comparison.differences:
        by_function.setdefault(difference.function, []).append(difference)
    lines: list[str] = []
    # differences without a function last; sorting keeps the order of the others
    for function, differences in sorted(by_function.items(), key=lambda item: item[0] == ""):
        if any(by_function):
            names = count_noun(len({difference.name for difference in differences}), "name")
            lines.append(f"{f'function {function}' if function else 'without a function'}, {names}:")
        lines += [*_table(differences, left, right, coloured), ""]
    return [*lines, _total(comparison, left, right)]


def _table(differences: Sequence[Difference], left: str, right: str, coloured: bool) -> list[str]:
    rows: list[tuple[str, ...]] = [("name", "what", left, right, "largest difference", "differ", "at")]
    rows += [_row(difference, left, right) for difference in differences]
    # differences in texts leave the last three columns empty
    used = [i for i in range(len(rows[0])) if i < 4 or any(row[i] for row in rows[1:])]
    colours = [_colour(difference) if coloured else "" for difference in differences]
    return _paint_rows(align([[row[i] for i in used] for row in rows]), colours)


def _row(difference: Difference, left: str, right: str) -> tuple[str, ...]:
    name, aspect, old, new = difference.name, difference.aspect, difference.left, difference.right
    if aspect == "presence":
        return (name, f"only in {left if old else right}", old or "-", new or "-", "", "", "")
    if difference.largest is None:
        return (name, aspect, _shorten_text(old), _shorten_text(new), "", "", "")
    share = f"{difference.count} of {difference.total}" if difference.total > 1 else ""
    return (name, aspect, old, new, f"{difference.largest:.6g}", share, difference.place)


def _shorten_text(text: str) -> str:
    cell = text if text == " ".join(text.split()) and text else repr(text)
    return cell if len(cell) <= _MAX_TEXT else f"{cell[: _MAX_TEXT - 3]}..."


def _total(comparison: Comparison, left: str, right: str) -> str:
    single = [d for d in comparison.differences if d.aspect == "presence"]
    in_both = len({d.name for d in comparison.differences if d.aspect != "presence"})
    in_left = sum(bool(d.left) for d in single)
    parts = [f"{in_both} of {count_noun(comparison.compared, 'name')} in both differ"]
    parts += [f"{in_left} only in {left}"] if in_left else []
    parts += [f"{len(single) - in_left} only in {right}"] if len(single) > in_left else []
    return ", ".join(parts)


def _colour(difference: Difference) -> str:
    if difference.aspect != "presence":
        return _YELLOW
    return _RED if difference.left else _GREEN


def _shows_colours() -> bool:
    """Return if stdout is a terminal that shows colours; the old console of Windows would print the codes."""
    old = os.name == "nt" and not ({"WT_SESSION", "ANSICON", "TERM"} & os.environ.keys())
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return sys.stdout.isatty() and not old and not plain


def _paint_rows(lines: list[str], colours: list[str]) -> list[str]:
    """Colour each row of a table; a row is a block of lines if the table exceeds the width of the terminal."""
    # a line for the heading and for each row: the table fits the terminal
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


def change_lines(changes: Iterable[Change], limit: int = 50) -> list[str]:
    """Return a line for each of the first `limit` changes, and their number for each file."""
    changes = list(changes)
    if not changes:
        return ["nothing to replace and nothing to add"]
    rows = [(change.name, _action(change), change.source, _details(change)) for change in changes[:limit]]
    counts = Counter((change.source, _action(change)) for change in changes)
    totals = [f"{source}: {count} {action}" for (source, action), count in counts.items()]
    return [*align([("name", "", "by", "what"), *rows]), *count_more(len(changes) - limit), "", *totals]


def _action(change: Change) -> str:
    return "replaced" if change.replaces else "added"


def _details(change: Change) -> str:
    if not change.replaces:
        return ""
    return "; ".join(map(_detail, change.differences)) or "equal values; description, inputs of axes or settings differ"


def _detail(difference: Difference) -> str:
    if difference.largest is None:
        return f"{difference.aspect} {_shorten_text(difference.left)} -> {_shorten_text(difference.right)}"
    if difference.total == 1:
        return f"{difference.left} -> {difference.right}"
    share = f"{difference.count} of {difference.total} {difference.aspect}"
    return f"{share}, the largest difference {difference.largest:.6g} at {difference.place}"
