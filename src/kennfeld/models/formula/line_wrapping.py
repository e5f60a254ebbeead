"""Long statements of formula text on several lines, which open brackets continue."""

from typing import Final, NamedTuple

from kennfeld.models.formula.lexer import tokens
from kennfeld.models.formula.syntax import Token

WIDTH: Final = 110
_INDENT: Final = "    "
# what a line is rather broken at comes first: an argument, a condition, a term, a factor
_BONDS: Final = ((",",), ("and", "or"), ("==", "!=", "<", "<=", ">", ">="), ("+", "-"), ("*", "/", "^"))


class _Break(NamedTuple):
    """A column at which a line may end, and how closely what it separates is bound: by brackets, then by operators.

    `ends` is True between the conditions of a chain, where a long statement is always broken.
    """

    column: int
    bond: int
    ends: bool = False


def wrap(statement: str) -> list[str]:
    """Return a statement `name = expression` on lines of at most `WIDTH` characters, if it can be broken there.

    A line ends after a comma or before an operator, where the fewest brackets are open, and before each `if` of a chain
    of them. An expression that is not one call is put in brackets.

    >>> wrap("y = " + " + ".join(["first_long_name", "second_long_name"] * 4))  # doctest: +NORMALIZE_WHITESPACE
    ['y = (first_long_name + second_long_name + first_long_name + second_long_name + first_long_name',
     '    + second_long_name + first_long_name + second_long_name)']
    """
    if len(statement) <= WIDTH:
        return [statement]
    words = tokens(statement, 1)
    start = next((at for at, word in enumerate(words) if word.text == "="), len(words)) + 1
    if start >= len(words):
        return [statement]
    if not _is_one_call(words[start:]):
        head = statement[: words[start].column - 1]
        statement = f"{head}({statement[len(head) :]})"
        words = tokens(statement, 1)
    return _broken(statement, _breaks(words, start))


def _is_one_call(words: list[Token]) -> bool:
    """Return True if the bracket that opens first closes last."""
    depth = 0
    for at, word in enumerate(words):
        depth += (word.text == "(") - (word.text == ")")
        if at and not depth:
            return at == len(words) - 1
    return False


def _breaks(words: list[Token], start: int) -> list[_Break]:
    breaks, depth = [], 0
    for before, word, after in zip(words[start - 1 :], words[start:], words[start + 1 :], strict=False):
        depth += (word.text == "(") - (word.text == ")")
        is_sign = before.kind == "op" and before.text != ")"  # in front of an operand
        if word.text == ",":
            breaks.append(_Break(after.column - 1, depth * len(_BONDS), after.text == "if"))
        elif word.kind == "op" and word.text not in "()" and not is_sign and depth:
            bond = next(at for at, operators in enumerate(_BONDS) if word.text in operators)
            breaks.append(_Break(word.column - 1, depth * len(_BONDS) + bond))
    return breaks


def _broken(statement: str, breaks: list[_Break]) -> list[str]:
    lines, begun, indent = [], 0, ""
    while len(indent) + len(statement) - begun > WIDTH or any(at.ends and at.column > begun for at in breaks):
        end = begun + WIDTH - len(indent)
        chained = next((at.column for at in breaks if at.ends and at.column > begun), end + 1)
        if chained <= end or len(indent) + len(statement) - begun <= WIDTH:
            lines.append(indent + statement[begun:chained].rstrip())
            begun, indent = chained, _INDENT
            continue
        within = [at for at in breaks if begun < at.column <= end]
        # not far to the left, where little would stand on the line
        late = [at for at in within if at.column > begun + WIDTH // 3] or within
        if not late:
            late = [at for at in breaks if at.column > end][:1]
            if not late:
                break
        best = min(late, key=lambda at: (at.bond, -at.column))
        lines.append(indent + statement[begun : best.column].rstrip())
        begun, indent = best.column, _INDENT
    return [*lines, indent + statement[begun:]]
