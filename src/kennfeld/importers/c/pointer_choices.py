"""Sequences of statements in which a pointer has one of several addresses, as a condition says.

The tree has no addresses, so that a pointer stands for the place that it leads to. Where a condition chooses among
places, all that follows in the block is translated once for each, under that condition:

    const float *x = hot ? HIGH : LOW;      if (hot) { y = HIGH[i]; } else { y = LOW[i]; }
    y = x[i];
"""

import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

from pycparser import c_ast

from kennfeld.importers.c.declarations import CFile, CFunctionDeclaration, CVariable, line_of
from kennfeld.importers.c.expression_translation import is_null
from kennfeld.importers.c.number_types import UnsupportedCError
from kennfeld.importers.c.object_translation import ObjectTranslation
from kennfeld.importers.c.places import CPlace, Scope
from kennfeld.program import tree as m

_MOST_CHOICES: Final = 64  # of a function: what follows is translated for each combination
_OPEN: Final = c_ast.EmptyStatement()  # begins a block whose statements precede those of the block around it
_CLOSE: Final = c_ast.EmptyStatement()
_LOOPS: Final = (c_ast.For, c_ast.While, c_ast.DoWhile, c_ast.Switch)
# statements of which a part may be translated for each of two addresses: C evaluates their parts in any order
_SIMPLE: Final = (c_ast.Assignment, c_ast.Decl, c_ast.Return, c_ast.FuncCall)
_UNORDERED: Final = (
    *_SIMPLE, c_ast.BinaryOp, c_ast.UnaryOp, c_ast.Cast, c_ast.ArrayRef, c_ast.StructRef, c_ast.InitList,
    c_ast.ExprList,
)  # fmt: skip


class _Choice(NamedTuple):
    """A condition, and the statements that run if it holds, or else."""

    condition: c_ast.Node
    sides: tuple[Sequence[c_ast.Node], Sequence[c_ast.Node]]


class PointerChoices(ObjectTranslation):
    """Translates blocks of statements, and the pointers that are set in them.

    `problems` are the statements that are not supported.
    """

    def __init__(self, file: CFile, function: CFunctionDeclaration, shared: Scope) -> None:
        super().__init__(file)
        self.function = function
        self.problems: list[UnsupportedCError] = []
        self.scopes = [shared, {}]
        self._pointers = {argument.variable.name for argument in function.arguments if argument.mode != "value"}
        self._pointers |= {node.name for node in nodes_of(function.tree.body) if _declares_pointer(node)}
        self._choices = 0

    def statement(self, tree: c_ast.Node) -> list[m.Statement]:
        """Translate a statement."""
        raise NotImplementedError

    def block(self, items: Iterable[c_ast.Node]) -> tuple[m.Statement, ...]:
        """Translate the statements of a block, with a scope of their own."""
        scopes, self.scopes = self.scopes, [*self.scopes, {}]
        result = self._sequence(list(items))
        self.scopes = scopes
        return tuple(result)

    def _sequence(self, items: Sequence[c_ast.Node]) -> list[m.Statement]:
        result: list[m.Statement] = []
        for at, item in enumerate(items):
            if item is _OPEN:
                self.scopes = [*self.scopes, {}]
            elif item is _CLOSE:
                self.scopes = self.scopes[:-1]
            elif isinstance(item, c_ast.Compound) and self._set_pointers(item):
                return [*result, *self._sequence([*_scoped(item), *items[at + 1 :]])]
            elif (choice := self._choice(item)) is not None:
                # what is declared or set has another place on each side
                is_alone = not isinstance(item, c_ast.Decl) and not self._set_pointers(item)
                following = [] if is_alone else items[at + 1 :]
                result += self._noted(item, partial(self._split, choice, following))
                if not is_alone:
                    return result
            else:
                result += self._checked(item)
        return result

    def _checked(self, item: c_ast.Node) -> list[m.Statement]:
        """Translate a statement whose pointers are known behind it, unless it is a loop or switch that sets them."""
        if not isinstance(item, _LOOPS):
            return self._noted(item, lambda: self.statement(item))
        self.forget_pointers(item)
        result = self._noted(item, lambda: self.statement(item))
        self.forget_pointers(item)
        return result

    def _noted(self, item: c_ast.Node, translate: Callable[[], list[m.Statement]]) -> list[m.Statement]:
        """Translate a statement; note why it is not supported, so that all problems are reported at once."""
        try:
            return self.with_pending(translate)
        except UnsupportedCError as error:
            line = error.line or line_of(item)
            self.problems.append(UnsupportedCError(error.message, line, wrong=error.wrong))
            # statements of the part that was translated before the error
            self.pending = []
            return []

    def with_pending(self, translate: Callable[[], list[m.Statement]]) -> list[m.Statement]:
        """Return statements behind those that their expressions need."""
        statements = translate()
        pending, self.pending = self.pending, []
        return [*pending, *statements]

    # choices

    def _split(self, choice: _Choice, following: Sequence[c_ast.Node]) -> list[m.Statement]:
        """Return what follows in a block under a condition, for each of two addresses."""
        self._choices += 1
        if self._choices > _MOST_CHOICES:
            message = f"more than {_MOST_CHOICES} choices among addresses, with those that follow from others"
            raise UnsupportedCError(message, line_of(choice.condition))
        place = m.TextPosition(line_of(choice.condition))
        tested = self.condition(choice.condition).tree
        pending, self.pending = self.pending, []
        scopes = self.scopes
        sides = []
        for side in choice.sides:
            self.scopes = [scopes[0], *(dict(scope) for scope in scopes[1:])]
            sides.append(tuple(self._sequence([*side, *following])))
        self.scopes = scopes
        return [*pending, m.If((m.Branch(tested, sides[0], place=place),), sides[1], place=place)]

    def _choice(self, item: c_ast.Node) -> _Choice | None:
        """Return the choice among addresses that a statement makes first, or None."""
        if isinstance(item, c_ast.If) and self._set_pointers(item):
            return _Choice(item.cond, (_scoped(item.iftrue), _scoped(item.iffalse)))
        if not isinstance(item, _SIMPLE) or "static" in getattr(item, "storage", ()):
            return None
        path = self._address_choice(item)
        if path is None:
            return None
        sides = []
        for name in ("iftrue", "iffalse"):
            changed = whole = copy.copy(item)
            for step in path[:-1]:
                changed = _replaced_child(changed, step, copy.copy(_child(changed, step)))
            chosen = getattr(_child(changed, path[-1]), name)
            _replaced_child(changed, path[-1], chosen)
            sides.append((whole,))
        node = item
        for step in path:
            node = _child(node, step)
        return _Choice(node.cond, (sides[0], sides[1]))

    def _address_choice(self, tree: c_ast.Node) -> tuple[str, ...] | None:
        """Return the path of names that leads to a choice between two addresses; None if there is none."""
        for name, child in tree.children():
            if isinstance(child, c_ast.TernaryOp):
                if self._is_address_side(child.iftrue) and self._is_address_side(child.iffalse):
                    return (name,)
            elif isinstance(child, _UNORDERED) and getattr(child, "op", "") not in ("&&", "||"):
                path = self._address_choice(child)
                if path is not None:
                    return (name, *path)
        return None

    def _is_address_side(self, tree: c_ast.Node) -> bool:
        if isinstance(tree, c_ast.TernaryOp):
            return self._is_address_side(tree.iftrue) and self._is_address_side(tree.iffalse)
        try:
            return self.is_address(tree.expr if isinstance(tree, c_ast.Cast) else tree)
        except UnsupportedCError:
            return False

    # pointers

    def declare_pointer(self, tree: c_ast.Decl) -> None:
        """Let the name of a pointer stand for the place that it leads to; for a reason, if it leads to none yet."""
        if tree.init is None or is_null(tree.init):
            reason = "is read before it is set" if tree.init is None else "is null here"
            self.scopes[-1][tree.name] = UnsupportedCError(f"the pointer {tree.name} {reason}")
            return
        is_constant = self.file.types.declared(tree).is_constant
        self.scopes[-1][tree.name] = self._alias(tree.init, is_constant=is_constant)

    def set_pointer(self, tree: c_ast.Assignment) -> bool:
        """Let a pointer stand for another place from here on; return False if the target is not a pointer."""
        if tree.op != "=" or not isinstance(tree.lvalue, c_ast.ID) or tree.lvalue.name not in self._pointers:
            return False
        name = tree.lvalue.name
        scope = next((scope for scope in reversed(self.scopes[1:]) if name in scope), None)
        before = scope[name] if scope is not None else None
        if scope is None or (isinstance(before, CVariable) and not (before.is_pointer and name in self._pointers)):
            return False
        is_constant = isinstance(before, CPlace | CVariable) and before.is_constant
        scope[name] = self._alias(tree.rvalue, is_constant=is_constant)
        return True

    def _alias(self, tree: c_ast.Node, *, is_constant: bool) -> CPlace:
        """Return the place of an address, whose indices keep the values that they have now."""
        place = self.frozen(self.address(tree), line_of(tree))
        return replace(place, is_constant=place.is_constant or is_constant)

    def forget_pointers(self, tree: c_ast.Node) -> None:
        """Note that the pointers that a statement sets have addresses that are not known."""
        for name in self._set_pointers(tree):
            scope = next((scope for scope in reversed(self.scopes[1:]) if name in scope), None)
            if scope is not None:
                message = f"the pointer {name} is set in a loop or switch and used elsewhere, which is not supported"
                scope[name] = UnsupportedCError(message, line_of(tree))

    def _set_pointers(self, tree: c_ast.Node) -> set[str]:
        """Return the names of the pointers that a statement sets."""
        targets = (node.lvalue for node in nodes_of(tree) if isinstance(node, c_ast.Assignment) and node.op == "=")
        return {target.name for target in targets if isinstance(target, c_ast.ID)} & self._pointers


def _declares_pointer(node: c_ast.Node) -> bool:
    return isinstance(node, c_ast.Decl) and isinstance(node.type, c_ast.PtrDecl)


def _scoped(tree: c_ast.Node | None) -> list[c_ast.Node]:
    """Return the statements of a block, between the marks of its scope."""
    if tree is None:
        return []
    return [_OPEN, *(tree.block_items or () if isinstance(tree, c_ast.Compound) else (tree,)), _CLOSE]


def _child(tree: c_ast.Node, step: str) -> c_ast.Node:
    name, _, index = step.partition("[")
    return getattr(tree, name)[int(index[:-1])] if index else getattr(tree, name)


def _replaced_child(tree: c_ast.Node, step: str, child: c_ast.Node) -> c_ast.Node:
    """Replace a child of a copied node; return the child."""
    name, _, index = step.partition("[")
    if index:
        children = list(getattr(tree, name))
        children[int(index[:-1])] = child
        setattr(tree, name, children)
    else:
        setattr(tree, name, child)
    return child


def nodes_of(tree: c_ast.Node) -> Iterator[c_ast.Node]:
    """Yield a node and all below it."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        waiting += [child for _, child in node.children()]
