"""Macros of the C preprocessor, with and without arguments."""

import re
from collections.abc import Mapping, Sequence
from typing import Final

from kennfeld.base.lazy_dataclass import dataclass

_TOKEN: Final = re.compile(
    r"""[A-Za-z_]\w*|\.?\d(?:[eEpP][+-]|[\w.])*|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'|\#\#|\s+|.""", re.DOTALL
)
_DEFINE: Final = re.compile(r"([A-Za-z_]\w*)(?:\(([^)]*)\))?\s*(.*)", re.DOTALL)
_MAX_TOKENS: Final = 2_000_000  # that all expansions of a file may visit

# the names of the macros that a token came from, which it is not expanded by again
_Hidden = frozenset[str]
_Token = tuple[str, _Hidden]


class MacroError(Exception):
    """A macro that cannot be defined or expanded; its text says why."""


@dataclass(frozen=True)
class Macro:
    """A macro: its replacement in tokens, and its arguments; None if it takes none, not even `()`."""

    body: tuple[str, ...]
    arguments: tuple[str, ...] | None = None


def tokens_of(text: str) -> tuple[str, ...]:
    """Split a text into tokens, with the spaces between them.

    >>> tokens_of("a + 1.5e-3*b")
    ('a', ' ', '+', ' ', '1.5e-3', '*', 'b')
    """
    return tuple(_TOKEN.findall(text))


def read_macro(text: str) -> tuple[str, Macro]:
    """Read name and macro from the text behind `#define`.

    Raises:
        MacroError: it has no name, or its arguments are not names.
    """
    match = _DEFINE.match(text)
    if match is None:
        raise MacroError("#define without a name")
    if match[2] is None:
        return match[1], Macro(tokens_of(match[3].strip()))
    arguments = tuple(word.strip() for word in match[2].split(",")) if match[2].strip() else ()
    if not all(re.fullmatch(r"[A-Za-z_]\w*|\.\.\.", word) for word in arguments):
        raise MacroError(f"the arguments of the macro {match[1]} are not names")
    return match[1], Macro(tokens_of(match[3].strip()), arguments)


class MacroExpansion:
    """Expands macros in lines of text, up to a number of tokens for all lines."""

    def __init__(self, macros: Mapping[str, Macro]) -> None:
        self.macros = macros
        self._visited = 0

    def expand(self, text: str) -> str:
        """Replace the macros in a text.

        Raises:
            MacroError: a call has the wrong number of arguments, or the expansion is too long.
        """
        if not any(token in self.macros for token in tokens_of(text)):
            return text
        return "".join(token for token, _ in self._expanded([(token, frozenset()) for token in tokens_of(text)]))

    def is_open(self, text: str) -> bool:
        """Return True if a text ends within the arguments of a macro, so that the next line belongs to it."""
        tokens = [token for token in tokens_of(text) if not token.isspace()]
        for at, token in enumerate(tokens):
            macro = self.macros.get(token)
            if macro is None or macro.arguments is None or tokens[at + 1 : at + 2] != ["("]:
                continue
            depth = 0
            for later in tokens[at + 1 :]:
                depth += (later == "(") - (later == ")")
                if depth == 0:
                    break
            if depth > 0:
                return True
        return False

    def _expanded(self, tokens: Sequence[_Token]) -> list[_Token]:
        # a stack, the next token last: a replacement is scanned again, together with what follows it (C11, 6.10.3.4)
        waiting, result = list(reversed(tokens)), list[_Token]()
        while waiting:
            self._visited += 1
            if self._visited > _MAX_TOKENS:
                raise MacroError("the macros expand to too much text")
            token, hidden = waiting.pop()
            macro = self.macros.get(token)
            if macro is None or token in hidden:
                result.append((token, hidden))
            elif macro.arguments is None:
                body = self._body(token, macro, {}, hidden)
                waiting += reversed(body)
            elif (values := _arguments(waiting)) is None:
                result.append((token, hidden))  # the name of a macro without a call
            else:
                waiting += reversed(self._body(token, macro, self._named(token, macro, values), hidden))
        return result

    def _named(self, name: str, macro: Macro, values: list[list[_Token]]) -> dict[str, list[_Token]]:
        names = macro.arguments or ()
        if names[-1:] == ("...",):
            fixed, rest = values[: len(names) - 1], values[len(names) - 1 :]
            comma: _Token = (",", frozenset())
            joined = [token for at, value in enumerate(rest) for token in ([comma, *value] if at else value)]
            return {**dict(zip(names, fixed, strict=False)), "__VA_ARGS__": joined}
        # the brackets of f() contain one argument, an empty one
        if not names and len(values) == 1 and not any(token.strip() for token, _ in values[0]):
            return {}
        if len(names) != len(values):
            raise MacroError(f"the macro {name} takes {len(names)} arguments, got {len(values)}")
        return dict(zip(names, values, strict=True))

    def _body(self, name: str, macro: Macro, values: Mapping[str, list[_Token]], hidden: _Hidden) -> list[_Token]:
        """Return the replacement of a macro, with its arguments expanded unless they are joined or quoted."""
        hidden |= {name}
        result: list[_Token] = []
        body = macro.body
        at = 0
        while at < len(body):
            token = body[at]
            following = next((later for later in range(at + 1, len(body)) if not body[later].isspace()), len(body))
            if token == "##":
                at = self._join(result, body, following, values, hidden)
                continue
            if token == "#" and values and body[following : following + 1] and body[following] in values:
                text = "".join(part for part, _ in values[body[following]]).strip()
                result.append((f'"{text}"', hidden))
                at = following + 1
                continue
            if token in values:
                is_joined = body[following : following + 1] == ("##",)
                result += values[token] if is_joined else self._expanded(values[token])
            else:
                result.append((token, hidden))
            at += 1
        # counts the text too: macros that name another one twice double it at each level
        self._visited += len(result)
        return result

    def _join(
        self, result: list[_Token], body: Sequence[str], at: int, values: Mapping[str, list[_Token]], hidden: _Hidden
    ) -> int:
        """Append the token behind ## to the last one; return the place behind it."""
        while result and result[-1][0].isspace():
            result.pop()
        right = body[at] if at < len(body) else ""
        parts = values.get(right, [(right, hidden)])
        left = result.pop()[0] if result else ""
        texts = [token for token, _ in parts if not token.isspace()]
        joined = left + (texts[0] if texts else "")
        result += [(token, hidden) for token in (*tokens_of(joined), *texts[1:])]
        return at + 1


def _arguments(waiting: list[_Token]) -> list[list[_Token]] | None:
    """Remove the arguments of a call from the tokens that wait, and return them; None if no call follows."""
    at = len(waiting) - 1
    while at >= 0 and waiting[at][0].isspace():
        at -= 1
    if at < 0 or waiting[at][0] != "(":
        return None
    depth, values = 0, [list[_Token]()]
    for place in range(at, -1, -1):
        token = waiting[place]
        depth += (token[0] == "(") - (token[0] == ")")
        if depth == 0:
            del waiting[place:]
            return [_stripped(value) for value in values]
        # a comma within inner brackets belongs to the argument
        if token[0] == "," and depth == 1:
            values.append([])
        elif place != at:
            values[-1].append(token)
    raise MacroError("the arguments of a macro have no closing bracket")


def _stripped(tokens: list[_Token]) -> list[_Token]:
    first, last = 0, len(tokens)
    while first < last and tokens[first][0].isspace():
        first += 1
    while last > first and tokens[last - 1][0].isspace():
        last -= 1
    return tokens[first:last]
