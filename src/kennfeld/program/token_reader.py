"""A reader of the tokens of a text, which the parsers of all languages are built on."""

from collections.abc import Callable, Sequence
from typing import ClassVar, Generic, Protocol, TypeVar


class ReadableToken(Protocol):
    """A token of any language: its kind, "end" for the last one, and its text."""

    @property
    def kind(self) -> str: ...

    @property
    def text(self) -> str: ...


AnyToken = TypeVar("AnyToken", bound=ReadableToken)
Result = TypeVar("Result")


class TokenReader(Generic[AnyToken]):
    """Reads tokens one after the other; the last one, of kind "end", stays the next one.

    Attributes:
        word_kinds: kinds of the tokens that are recognized by their text.
        max_depth: how deeply a text may be nested.
    """

    word_kinds: ClassVar[tuple[str, ...]] = ("operator",)
    max_depth: ClassVar[int] = 100

    def __init__(self, tokens: Sequence[AnyToken]) -> None:
        self.tokens, self.at, self.depth = tokens, 0, 0

    @property
    def token(self) -> AnyToken:
        """The next token."""
        return self.tokens[self.at]

    def ahead(self, count: int) -> AnyToken:
        """Return a later token; the last one behind the end."""
        return self.tokens[min(self.at + count, len(self.tokens) - 1)]

    def take(self) -> AnyToken:
        """Return the next token and step over it."""
        token = self.tokens[self.at]
        # readers look at the next token without a test for the end
        self.at += token.kind != "end"
        return token

    def is_at(self, *texts: str) -> bool:
        """Return True if the next token is one of these words or operators."""
        token = self.tokens[self.at]
        return token.text in texts and token.kind in self.word_kinds

    def accept(self, *texts: str) -> bool:
        """Step over the next token if it is one of these words or operators."""
        result = self.is_at(*texts)
        self.at += result
        return result

    def expect(self, text: str) -> AnyToken:
        """Step over a word or operator that must follow."""
        if not self.is_at(text):
            raise self.missing(text)
        return self.take()

    def missing(self, text: str) -> Exception:
        """Return the error that another token than `text` follows."""
        raise NotImplementedError

    def too_deep(self) -> Exception:
        """Return the error that the text is nested too deeply."""
        raise NotImplementedError

    def enter(self) -> None:
        """Go one level deeper; who calls it subtracts 1 from `depth` behind the level."""
        self.depth += 1
        if self.depth > self.max_depth:
            raise self.too_deep()

    def nested(self, read: Callable[[], Result]) -> Result:
        """Call `read` one level deeper; the depth stays right if the parser goes on behind an error."""
        try:
            self.enter()
            return read()
        finally:
            self.depth -= 1

    def listed(self, closing: str, read: Callable[[], Result]) -> tuple[Result, ...]:
        """Read items with commas between them, up to behind a closing bracket; the last one may have a comma too."""
        items: list[Result] = []
        while not self.accept(closing):
            items.append(read())
            if not self.is_at(closing):
                self.expect(",")
        return tuple(items)

    def series(self, read: Callable[[], Result]) -> tuple[Result, ...]:
        """Read one or more items with commas between them."""
        items = [read()]
        while self.accept(","):
            items.append(read())
        return tuple(items)
