"""Lexer of ESDL: a text to tokens with their positions, without blanks and comments.

An unclosed comment or text is a token of kind "open". A documentation comment `/** ... */` is kept with the token that
follows it.
"""

import re
from typing import Final, NamedTuple

from kennfeld.program.positions import TextLines, TextPosition
from kennfeld.program.tokens import scan_tokens

MAX_CHARACTERS: Final = 4_000_000  # of a file

# in 1..5, 1 is an integer and .. the operator of a range
_TOKEN = re.compile(
    r"""(?P<blank>[\s\ufeff]+)
  | (?P<comment>//[^\n]*|/\*.*?\*/)
  | (?P<open>/\*.*|"(?:[^"\\\n]|\\.)*(?![^"\\\n]|\\.|"))
  | (?P<number>0[xX][0-9A-Fa-f_]+|[0-9][0-9_]*(?:\.(?!\.)[0-9_]*)?(?:[eE][+-]?[0-9]+)?)
  | (?P<name>[^\W\d]\w*)
  | (?P<text>"(?:[^"\\\n]|\\.)*")
  | (?P<operator>\.\.|<-|->|<<=?|>>=?|<=|>=|==|!=|&&|\|\||[-+*/%&|^]=|\+\+|--|[-+*/%<>=!~&|^.,;:(){}\[\]@?])
  | (?P<bad>.)""",
    re.VERBOSE | re.DOTALL,
)
# the stars at the beginning of the lines of a comment
_DECORATION = re.compile(r"^\s*\*+ ?|\s+$", re.MULTILINE)
_MARKUP = re.compile(r"</?[a-zA-Z][^<>]*>")
_MAX_DESCRIPTION = 1000  # characters


class Token(NamedTuple):
    """A token, of kind "name", "number", "text", "operator" or "end"; "open" and "bad" are errors.

    `description` is the documentation comment before it.
    """

    kind: str
    text: str
    place: TextPosition
    description: str = ""

    @property
    def end(self) -> int:
        """The offset behind the token."""
        return self.place.offset + len(self.text)


def tokens_of(text: str) -> list[Token]:
    """Split a text into tokens, closed by one of kind "end".

    >>> [token.text for token in tokens_of("real x = 1_000.5; // a comment")]
    ['real', 'x', '=', '1_000.5', ';', '']
    """
    lines = TextLines(text)
    result: list[Token] = []
    description = ""
    for kind, written, offset in scan_tokens(_TOKEN, text):
        if kind != "comment":
            result.append(Token(kind, written, lines.position(offset), description))
            description = ""
        elif written.startswith("/**") and len(written) > len("/***/"):
            description = _plain_text(written)
    result.append(Token("end", "", lines.position(len(text))))
    return result


def _plain_text(comment: str) -> str:
    """Return a documentation comment as one line without markup."""
    plain = _MARKUP.sub("", _DECORATION.sub("", comment[3:-2]))
    return " ".join(plain.split())[:_MAX_DESCRIPTION]
