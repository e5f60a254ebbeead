"""Translation of whole objects of C: copies, first values, results that are structs, and compound literals."""

from collections.abc import Sequence
from dataclasses import replace

from pycparser import c_ast

from kennfeld.importers.c.call_translation import CCallTranslation
from kennfeld.importers.c.declarations import CVariable, line_of, variable_of
from kennfeld.importers.c.expression_translation import call_of, converted
from kennfeld.importers.c.initial_values import count_elements, initial_trees
from kennfeld.importers.c.number_types import UnsupportedCError
from kennfeld.importers.c.places import CPlace, assigned_leaves, parts_of
from kennfeld.importers.c.sizes import size_of
from kennfeld.importers.c.struct_types import CStructType, Leaf, constant_integer
from kennfeld.program import tree as m

_VALUES = c_ast.ID | c_ast.StructRef | c_ast.ArrayRef | c_ast.UnaryOp
_OBJECTS = c_ast.FuncCall | c_ast.CompoundLiteral | c_ast.TernaryOp | c_ast.Assignment


class ObjectTranslation(CCallTranslation):
    """Translates what concerns structs and arrays as a whole."""

    def object_place(self, tree: c_ast.Node) -> CPlace:
        match tree:
            case c_ast.FuncCall():
                if self.passes_back(tree):
                    place = self.returned_address(tree)
                    return replace(place, is_pointer=not place.sizes)
                return self.called_struct(tree)
            case c_ast.CompoundLiteral(type=kind, init=values):
                return self._literal(kind, values, tree)
            case c_ast.TernaryOp(cond=condition, iftrue=yes, iffalse=no):
                return self._chosen(condition, yes, no)
        assert isinstance(tree, c_ast.Assignment)
        copies = self.copies(tree)
        if copies is None:
            raise UnsupportedCError("an assignment of a number is not an object", line_of(tree), wrong=True)
        self.pending += copies
        return self.place(tree.lvalue)

    def _literal(self, kind: c_ast.Typename, values: c_ast.InitList, tree: c_ast.Node) -> CPlace:
        """Return the object of a compound literal, such as `(Gains){1, 2}`."""
        name = self.temporary()
        declaration = c_ast.Decl(name, [], [], [], [], kind.type, values, None, tree.coord)
        variable = variable_of(declaration, name, self.file, count_elements(values, self.file.types.constants))
        self.pending += self.first_assignments(declaration, replace(variable, is_constant=False))
        self.scopes[-1][name] = variable
        return self.place(c_ast.ID(name, tree.coord))

    def _chosen(self, condition: c_ast.Node, yes: c_ast.Node, no: c_ast.Node) -> CPlace:
        """Return the struct that a condition chooses."""
        line = line_of(condition)
        tested = self.operand(condition).tree
        source, before = self.apart(lambda: self.place(yes))
        result = CPlace(CVariable(self.temporary(), source.type), "", source.type, source.sizes)
        self.pending += self.filled(list(map(result.leaf, result.leaves)), result, line)
        sides = [[*before, *self.copied(result, source, line)]]
        source, before = self.apart(lambda: self.place(no))
        sides.append([*before, *self.copied(result, source, line)])
        place = m.TextPosition(line)
        self.pending.append(m.If((m.Branch(tested, tuple(sides[0]), place=place),), tuple(sides[1]), place=place))
        return result

    # copies

    def copies(self, tree: c_ast.Assignment) -> list[m.Statement] | None:
        """Return the statements that copy a struct; None if the target is a number."""
        if tree.op != "=" or not isinstance(tree.rvalue, _VALUES | _OBJECTS):
            return None
        # apart, since a target that is a number is translated again by `_assignment`
        target, statements = self.apart(lambda: self.place(tree.lvalue))
        if target.is_pointer or target.sizes or not isinstance(target.type, CStructType):
            return None
        self.pending += statements
        return self.copied(target, self.place(tree.rvalue), line_of(tree))

    def copied(self, target: CPlace, source: CPlace, line: int) -> list[m.Statement]:
        """Return the statements that copy all numbers of a place to another one."""
        if target.is_constant:
            raise UnsupportedCError(f"{target.label} is const and cannot be assigned", line, wrong=True)
        pairs = assigned_leaves(target, source)
        values = [self.value_of(of) for _, of in pairs]
        return self._assigned([to for to, _ in pairs], values, target, line)

    def _assigned(
        self, parts: Sequence[CPlace], values: Sequence[m.Expression], target: CPlace, line: int
    ) -> list[m.Statement]:
        """Return the statements that assign the parts of an object, which may be a member of a union."""
        place = m.TextPosition(line)
        before: list[m.Statement] = []
        if target.unions:  # a value may be of the member that the assignment replaces
            names = [m.Name(self.temporary()) for _ in values]
            before = [m.Assign((name,), value, place=place) for name, value in zip(names, values, strict=True)]
            before += self.marked(target, line)
            values = names
        return [*before, *(m.Assign((self.used(to),), of, place=place) for to, of in zip(parts, values, strict=True))]

    def filled(self, parts: Sequence[CPlace], target: CPlace, line: int) -> list[m.Statement]:
        """Return the statements that set the parts of an object to 0."""
        return self._assigned(parts, [zeros_of(part.sizes) for part in parts], target, line)

    # memset and memcpy

    def memory_call(self, name: str, tree: c_ast.FuncCall) -> list[m.Statement]:
        """Return the statements of memset with 0, or of memcpy, of an object or of the first elements of an array."""
        arguments, line = list(tree.args.exprs) if tree.args is not None else [], line_of(tree)
        if len(arguments) != 3:
            raise UnsupportedCError(f"{name} takes 3 arguments, got {len(arguments)}", line, wrong=True)
        target, value, written = arguments
        size = constant_integer(written, self.file.types.constants, self._bytes)
        place = self.address(target)
        parts = self._first_parts(name, place, size, line)
        if name == "memcpy":
            source = self.address(value)
            sources = self._first_parts(name, source, size, line)
            if len(parts) != len(sources):  # one of two arrays is copied as a whole
                parts, sources = _elements(parts), _elements(sources)
            if len(parts) != len(sources):
                raise UnsupportedCError(f"{place.label} and {source.label} have different types", line)
            return [each for pair in zip(parts, sources, strict=True) for each in self.copied(*pair, line)]
        if not isinstance(value, c_ast.Constant) or value.value not in ("0", "0U", "0u"):
            raise UnsupportedCError("memset is supported with 0 only", line)
        return self.filled([number for part in parts for number in parts_of(part)], place, line)

    def _first_parts(self, name: str, place: CPlace, size: int, line: int) -> list[CPlace]:
        """Return the object if it has a size in bytes, or the first elements of an array that have it together."""
        sizes = (place.sizes[0] - place.first, *place.sizes[1:]) if place.sizes else ()
        whole = size_of(self.file.types, place.type, sizes)
        if whole == size and place.start is None:
            return [place]
        step = size_of(self.file.types, place.type, sizes[1:]) if sizes else 0
        if not step or size % step or not 0 <= size // step <= sizes[0]:
            message = f"{name} of {size} bytes of {place.label}, which has {whole}, is not supported"
            raise UnsupportedCError(message, line)
        return [place.element(m.Number(at + 1.0)) for at in range(size // step)]

    # first values

    def first_assignments(self, tree: c_ast.Decl, variable: CVariable) -> list[m.Statement]:
        """Return the statements that give a variable the first values of a list."""
        place = m.TextPosition(line_of(tree))
        values = self.first_values(tree, variable)
        self.note_precision(variable.type)
        return [m.Assign((m.Name(f"{variable.name}{leaf.path}"),), value, place=place) for leaf, value in values]

    def first_values(self, tree: c_ast.Decl, variable: CVariable) -> list[tuple[Leaf, m.Expression]]:
        """Return the numbers of a variable with the trees of their first values: zeros, where none is written."""
        try:
            trees = initial_trees(
                tree.init, variable.type, variable.sizes, self.file.types.constants, self._named_struct
            )
        except UnsupportedCError as error:
            raise UnsupportedCError(f"{tree.name}: {error.message}", line_of(tree), wrong=error.wrong) from None
        return [(leaf, self._first_value(leaf, trees[leaf.path])) for leaf in variable.leaves]

    def _first_value(self, leaf: Leaf, trees: Sequence[c_ast.Node | None]) -> m.Expression:
        if all(tree is None for tree in trees):
            return zeros_of(leaf.sizes)
        zero = m.Number(0.0)
        items = [zero if tree is None else converted(self.operand(tree), leaf.type) for tree in trees]
        if not leaf.sizes:
            return items[0]
        sizes = [m.Number(float(size)) for size in (len(leaf.sizes), *leaf.sizes)]
        return call_of("array", *sizes, *items)

    def _named_struct(self, tree: c_ast.Node) -> c_ast.Node | None:
        """Return an expression that names the struct of another one; None if that one is a number."""
        if not isinstance(tree, _VALUES | _OBJECTS):
            return None
        place, statements = self.apart(lambda: self._place_or_none(tree))
        if place is None or place.is_pointer or place.sizes or not isinstance(place.type, CStructType):
            return None
        self.pending += statements
        if isinstance(tree, _VALUES):
            return tree
        if isinstance(tree, c_ast.Assignment):
            return tree.lvalue
        self.scopes[-1][place.variable.name] = place.variable
        return c_ast.ID(place.variable.name, tree.coord)

    def _place_or_none(self, tree: c_ast.Node) -> CPlace | None:
        try:
            return self.place(tree)
        except UnsupportedCError:
            return None


def _elements(parts: Sequence[CPlace]) -> list[CPlace]:
    """Return the elements of a single array; several parts as they are."""
    if len(parts) > 1 or not parts[0].sizes:
        return list(parts)
    return [parts[0].element(m.Number(at + 1.0)) for at in range(parts[0].sizes[0])]


def zeros_of(sizes: Sequence[int]) -> m.Expression:
    """Return the tree of zeros."""
    return call_of("zeros", *(m.Number(float(size)) for size in sizes)) if sizes else m.Number(0.0)
