"""Sequences of statements in which a pointer has one of several addresses, as a condition says.

The tree has no addresses, so that a pointer stands for the place that it leads to. Where a condition chooses among
places, all that follows in the block is translated once for each, under that condition:

    const float *x = hot ? HIGH : LOW;      if (hot) { y = HIGH[i]; } else { y = LOW[i]; }
    y = x[i];
"""

import copy
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

from pycparser import c_ast

from kennfeld.importers.c.addresses import NULL, DeclaredPointer
from kennfeld.importers.c.declarations import CFile, CFunctionDeclaration, CVariable, line_of
from kennfeld.importers.c.expression_translation import is_null
from kennfeld.importers.c.number_types import UnsupportedCError
from kennfeld.importers.c.object_translation import ObjectTranslation
from kennfeld.importers.c.places import CPlace, Scope
from kennfeld.importers.c.struct_types import DeclaredType
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
        self.moving = self._pointers & set(_moved_names(function.tree.body))
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
            elif isinstance(item, c_ast.Compound) and self._chosen_pointers(item):
                return [*result, *self._sequence([*_scoped(item), *items[at + 1 :]])]
            elif (choice := self._choice(item)) is not None:
                # what is declared or set has another place on each side
                is_alone = not isinstance(item, c_ast.Decl) and not self._chosen_pointers(item)
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
        if isinstance(item, c_ast.If) and self._chosen_pointers(item):
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
        declared = self.file.types.declared(tree)
        pointer = self.add_pointer(tree.name, declared.type, moves=tree.name in self.moving)
        if tree.init is None or is_null(tree.init):
            reason = "is read before it is set" if tree.init is None else "is null here"
            self.scopes[-1][tree.name] = UnsupportedCError(f"the pointer {tree.name} {reason}")
            if tree.init is not None:
                self._set_null(pointer, line_of(tree))
            return
        place = self._alias(tree.init, pointer, is_constant=declared.is_constant)
        self.check_type(place, declared, line_of(tree))
        self.scopes[-1][tree.name] = place

    def declare_argument(self, variable: CVariable) -> list[m.Statement]:
        """Declare an argument; return the statement that sets the index of a pointer that moves."""
        self.scopes[-1][variable.name] = variable
        if variable.name not in self.moving or not variable.sizes:
            return []
        pointer = self.add_pointer(variable.name, variable.type, moves=True)
        place = CPlace(variable, "", variable.type, variable.sizes, is_constant=variable.is_constant)
        self.scopes[-1][variable.name] = replace(place, start=pointer.place)
        return [m.Assign((pointer.place,), m.Number(0.0), place=m.TextPosition(self.function.line))]

    def set_pointer(self, tree: c_ast.Node) -> bool:
        """Let a pointer stand for another place from here on, or move it; return False for other statements."""
        if isinstance(tree, c_ast.UnaryOp):
            if not isinstance(tree.expr, c_ast.ID) or self.moving_pointer(tree.expr.name) is None:
                return False
            self.address(tree)
            return True
        if tree.op not in ("=", "+=", "-=") or not isinstance(tree.lvalue, c_ast.ID):
            return False
        name = tree.lvalue.name
        scope = next((scope for scope in reversed(self.scopes[1:]) if name in scope), None)
        before = scope[name] if scope is not None and name in self._pointers else None
        pointer = self.declared_pointer(name)
        if scope is None or before is None or (isinstance(before, CVariable) and not before.is_pointer):
            return False
        if tree.op != "=":
            if pointer is None or not pointer.variable:
                return False
            self.step_pointer(tree.lvalue, self.signed(tree.op[0], tree.rvalue), tree)
        elif is_null(tree.rvalue) and pointer is not None and pointer.variable:
            self._set_null(pointer, line_of(tree))
        else:
            is_constant = isinstance(before, CPlace | CVariable) and before.is_constant
            place = self._alias(tree.rvalue, pointer, is_constant=is_constant)
            kind = pointer.type if pointer is not None else getattr(before, "type", place.type)
            self.check_type(place, DeclaredType(kind), line_of(tree))
            scope[name] = place
        return True

    def _set_null(self, pointer: DeclaredPointer | None, line: int) -> None:
        if pointer is not None and pointer.variable:
            self.pending.append(m.Assign((pointer.place,), NULL, place=m.TextPosition(line)))

    def _alias(self, tree: c_ast.Node, pointer: DeclaredPointer | None, *, is_constant: bool) -> CPlace:
        """Return the place of an address, whose indices keep the values that they have now."""
        line = line_of(tree)
        moves = pointer is not None and bool(pointer.variable)
        place = self.frozen(self.address(tree, is_flat=moves), line)
        if pointer is not None and moves and place.sizes:
            start = place.start or m.Number(0.0)
            self.pending.append(m.Assign((pointer.place,), start, place=m.TextPosition(line)))
            place = replace(place, start=pointer.place)
        return replace(place, is_constant=place.is_constant or is_constant)

    def forget_pointers(self, tree: c_ast.Node) -> None:
        """Note that the pointers that a statement sets have addresses that are not known, but for their indices."""
        for name in self._set_pointers(tree):
            scope = next((scope for scope in reversed(self.scopes[1:]) if name in scope), None)
            if scope is not None:
                message = f"the pointer {name} is set in a loop or switch and used elsewhere, which is not supported"
                scope[name] = self._common_place(name, tree) or UnsupportedCError(message, line_of(tree))

    def _chosen_pointers(self, tree: c_ast.Node) -> set[str]:
        """Return the pointers that a statement sets under conditions, unless they lead into one array all the same."""
        chosen = set()
        for name in self._set_pointers(tree):
            place = self._common_place(name, tree)
            if place is None:
                chosen.add(name)
            else:
                next(scope for scope in reversed(self.scopes) if name in scope)[name] = place
        return chosen

    def _array(self, tree: c_ast.Node) -> CPlace:
        """Return the array that an address leads into; nothing runs for it."""
        place, _ = self.apart(lambda: self.address(_array_of(tree), is_flat=True))
        return place

    def _common_place(self, name: str, tree: c_ast.Node) -> CPlace | None:
        """Return the array into which a pointer leads before and behind a statement; None if there are several."""
        pointer = self.moving_pointer(name)
        if pointer is None:
            return None
        values = [value for value in _assigned_values(tree, name, self._pointers) if not is_null(value)]
        try:
            places = [self._array(value) for value in values]
        except UnsupportedCError:
            return None
        before = next(scope[name] for scope in reversed(self.scopes) if name in scope)
        if isinstance(before, CPlace):
            places.append(before)
        elif not isinstance(before, UnsupportedCError):
            return None
        arrays = [place.array for place in places]
        is_common = all(array == arrays[0] and array.sizes for array in arrays)
        if not is_common or not all(isinstance(index, m.Number) for index in arrays[0].indices):
            return None
        is_constant = any(place.is_constant for place in places)
        return replace(arrays[0], start=pointer.place, is_constant=is_constant)

    def _set_pointers(self, tree: c_ast.Node) -> set[str]:
        """Return the names of the pointers that a statement sets."""
        targets = (node.lvalue for node in nodes_of(tree) if isinstance(node, c_ast.Assignment) and node.op == "=")
        return {target.name for target in targets if isinstance(target, c_ast.ID)} & self._pointers


def _declares_pointer(node: c_ast.Node) -> bool:
    return isinstance(node, c_ast.Decl) and isinstance(node.type, c_ast.PtrDecl)


def _moved_names(tree: c_ast.Node) -> Iterator[str]:
    """Yield the names of variables that count up or down, or are set in a loop or a switch."""
    for node in nodes_of(tree):
        if isinstance(node, c_ast.UnaryOp) and node.op in ("++", "--", "p++", "p--"):
            targets = [node.expr]
        elif isinstance(node, c_ast.Assignment) and (node.op in ("+=", "-=") or _is_step(node)):
            targets = [node.lvalue]
        elif isinstance(node, _LOOPS):
            targets = [each.lvalue for each in nodes_of(node) if isinstance(each, c_ast.Assignment)]
        else:
            continue
        yield from (str(target.name) for target in targets if isinstance(target, c_ast.ID))


def _is_step(tree: c_ast.Assignment) -> bool:
    """Return True for `p = p + 1`."""
    return isinstance(tree.lvalue, c_ast.ID) and any(
        isinstance(node, c_ast.ID) and node.name == tree.lvalue.name for node in nodes_of(tree.rvalue)
    )


def _assigned_values(tree: c_ast.Node, name: str, pointers: Collection[str]) -> Iterator[c_ast.Node]:
    """Yield the addresses to which a statement sets a pointer: of another one that it declares, those of that one."""
    seen, waiting = {name}, [name]
    while waiting:
        name = waiting.pop()
        for node in nodes_of(tree):
            if isinstance(node, c_ast.Assignment) and node.op == "=" and getattr(node.lvalue, "name", None) == name:
                value = node.rvalue
            elif isinstance(node, c_ast.Decl) and node.name == name and node.init is not None:
                value = node.init
            else:
                continue
            array = _array_of(value)
            base = str(array.name) if isinstance(array, c_ast.ID) else ""
            if base not in pointers or not _declares(tree, base):
                yield value
            elif base not in seen:
                seen.add(base)
                waiting.append(base)


def _declares(tree: c_ast.Node, name: str) -> bool:
    return any(isinstance(node, c_ast.Decl) and node.name == name for node in nodes_of(tree))


def _array_of(tree: c_ast.Node) -> c_ast.Node:
    """Return an address without its last index: of `&a[i]` and `a + i` that of `a`."""
    match tree:
        case c_ast.Cast(expr=of):
            return _array_of(of)
        case c_ast.UnaryOp(op="&", expr=c_ast.ArrayRef(name=of)) | c_ast.ArrayRef(name=of):
            return _array_of(of) if isinstance(of, c_ast.ArrayRef) else of
        case c_ast.BinaryOp(op="+" | "-", left=c_ast.ID() | c_ast.StructRef() | c_ast.ArrayRef() as of):
            return _array_of(of)
    return tree


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
