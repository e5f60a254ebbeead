"""A parser of operators by their precedence, which each language feeds with a table.

The method is precedence climbing: an operand takes all operators behind it that bind at least as tightly as asked for.
The right operand of an operator asks for those that bind more tightly than it does, so that equal ones associate to the
left. Without recursion through all levels, a number alone costs one call.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Generic, TypeVar

from kennfeld.program.token_reader import AnyToken, TokenReader

Tree = TypeVar("Tree")


def operator_levels(*levels: Sequence[str]) -> dict[str, int]:
    """Return the level of each operator, from those that bind least tightly.

    >>> operator_levels(("+", "-"), ("*", "/"))
    {'+': 0, '-': 0, '*': 1, '/': 1}
    """
    return {operator: level for level, operators in enumerate(levels) for operator in operators}


class OperatorParser(TokenReader[AnyToken], Generic[AnyToken, Tree]):
    """Parses operands joined by binary operators.

    Attributes:
        levels: the level of each binary operator; those of a higher level bind more tightly.
        max_terms: how many operators may join operands side by side; they make a tree of that depth.
    """

    levels: ClassVar[Mapping[str, int]]
    max_terms: ClassVar[int] = 2**31

    def operations(self, lowest: int = 0) -> Tree:
        """Parse operands joined by operators of a level and those above it."""
        tree = self.operand(lowest)
        for _ in range(self.max_terms):
            # -1 behind the last operand, so that each caller up to the outermost returns
            level = self.level()
            if level < lowest:
                return tree
            tree = self.joined(tree, level)
        raise self.too_many_terms()

    def level(self) -> int:
        """Return the level of the next token; -1 if it is not a binary operator, which its text alone tells."""
        return self.levels.get(self.tokens[self.at].text, -1)

    def operand(self, lowest: int) -> Tree:
        """Parse an operand with what binds more tightly than binary operators; `lowest` is the level asked for."""
        raise NotImplementedError

    def joined(self, left: Tree, level: int) -> Tree:
        """Parse the next operator, of a level, with its right operand; return the tree of the operation."""
        raise NotImplementedError

    def too_many_terms(self) -> Exception:
        """Return the error that an expression has too many terms."""
        raise NotImplementedError
