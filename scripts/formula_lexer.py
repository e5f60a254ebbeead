"""Colours formula text (`.kf`) on the site: a lexer for Pygments."""

from pygments.lexer import RegexLexer, bygroups, words
from pygments.token import Comment, Keyword, Name, Number, Operator, Punctuation, String, Text

from kennfeld.models.formula.lexer import DECLARATIONS, RESERVED

__all__ = ["FormulaLexer"]

_NAME = r"[^\W\d]\w*(?:\.\w+)*"
_OPERATORS = {"and", "or", "not"}
_CONSTANTS = RESERVED - _OPERATORS - {"if"}


class FormulaLexer(RegexLexer):
    """Tokens of formula text.

    >>> [str(kind) for kind, text in FormulaLexer().get_tokens("y = PT1(u, 2.0)") if text == "PT1"]
    ['Token.Name.Function']
    """

    name = "Kennfeld formula"
    aliases = ("kf",)
    filenames = ("*.kf",)
    tokens = {  # noqa: RUF012 - as Pygments declares it
        "root": [
            (r"#.*", Comment.Single),
            (r"\s+", Text),
            (rf"({'|'.join(sorted(DECLARATIONS))})([ \t]+)(?=[\w%])", bygroups(Keyword.Declaration, Text)),
            (words(sorted(_OPERATORS), suffix=r"\b"), Operator.Word),
            (words(sorted(_CONSTANTS), suffix=r"\b(?![\w.(])"), Name.Constant),
            (rf"{_NAME}(?=\s*\()", Name.Function),
            (_NAME, Name.Variable),
            (r"%(?:[^%]|%%)+%", Name.Variable),
            (r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?", Number),
            (r"\[[^\]\n]*\]", String.Other),
            (r"<=|>=|==|!=|[-+*/^<>=]", Operator),
            (r"[(),]", Punctuation),
        ]
    }
