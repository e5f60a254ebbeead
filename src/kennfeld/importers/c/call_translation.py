"""Translation of calls: of functions of the C library, and of those of the file, with the addresses they get."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from pycparser import c_ast

from kennfeld.importers.c.declarations import CArgument, CFunctionDeclaration, CVariable, line_of
from kennfeld.importers.c.expression_translation import COperand, PassedNames, call_of, converted
from kennfeld.importers.c.library_calls import LibraryCalls
from kennfeld.importers.c.number_types import INT, CType, UnsupportedCError, same_type
from kennfeld.importers.c.places import CPlace, single_numbers
from kennfeld.importers.c.struct_types import CStructType
from kennfeld.program import tree as m

_COUNTING: Final = ("++", "--", "p++", "p--")


class _PassedArguments(NamedTuple):
    """A call with its arguments, the targets of what it writes through addresses, and copies behind the call."""

    call: m.Call
    targets: Sequence[m.Expression]
    copies: Sequence[m.Statement]


class CCallTranslation(LibraryCalls):
    """Translates calls."""

    def call(self, tree: c_ast.FuncCall, *, wants_result: bool = True) -> COperand:
        """Translate a call of a function of the file or of the C library."""
        if not isinstance(tree.name, c_ast.ID):
            raise UnsupportedCError("calls through pointers are not supported")
        name = str(tree.name.name)
        trees = list(tree.args.exprs) if tree.args is not None else []
        if name in self.file.unsupported:
            error = self.file.unsupported[name]
            raise UnsupportedCError(f"{name} is not supported: {error.message}", line_of(tree))
        if name in self.file.functions:
            self.calls[name] = None
            function = self.file.functions[name]
            return self._called_number(function, trees, line_of(tree), wants_result=wants_result)
        return self.library_call(name, trees, tree)

    def returned_address(self, tree: c_ast.FuncCall) -> CPlace:
        if not self.passes_back(tree):
            raise UnsupportedCError("only addresses of variables and arrays are supported", line_of(tree))
        function = self.file.functions[tree.name.name]
        names = [argument.variable.name for argument in function.arguments]
        if tree.args is not None and changes_a_variable(tree.args):
            message = f"a variable that changes within the arguments of {function.name}, which returns one of them,"
            raise UnsupportedCError(f"{message} is not supported", line_of(tree))
        self.call(tree, wants_result=False)
        return self.address(tree.args.exprs[names.index(function.passed_back)])

    def called_struct(self, tree: c_ast.FuncCall) -> CPlace:
        """Return the place of a result that is a struct."""
        function = self.file.functions.get(getattr(tree.name, "name", ""))
        if function is None or not isinstance(function.result, CStructType):
            self.call(tree)  # which names what is not supported
            raise UnsupportedCError("a result is a number, not a struct", line_of(tree), wrong=True)
        self.calls[function.name] = None
        trees, line = list(tree.args.exprs) if tree.args is not None else [], line_of(tree)
        passed = self._arguments(function, trees, line)
        result = CPlace(CVariable(self.temporary(), function.result), "", function.result)
        targets = [result.leaf(leaf).tree for leaf in result.leaves]
        self._add_call(passed, targets, line)
        return result

    def _called_number(
        self, function: CFunctionDeclaration, trees: Sequence[c_ast.Node], line: int, *, wants_result: bool
    ) -> COperand:
        if wants_result and function.passed_back:
            message = f"{function.name} returns an address, that of its argument {function.passed_back}, not a number"
            raise UnsupportedCError(f"{message}; read the number behind it, as *{function.name}(...)", line)
        if wants_result and function.result is None:
            raise UnsupportedCError(f"{function.name} returns no value", wrong=True)
        if isinstance(function.result, CStructType):
            raise UnsupportedCError(f"{function.name} returns a struct, not a number", wrong=True)
        passed = self._arguments(function, trees, line)
        # a call that writes nothing stays an expression; any other is a statement before the one that reads its value
        if not passed.targets and function.result is not None:
            return COperand(passed.call, function.result)
        result = m.Name(self.temporary())
        self._add_call(passed, [result] if function.result is not None else [], line)
        return COperand(result, function.result or INT)

    def _add_call(self, passed: "_PassedArguments", results: Sequence[m.Expression], line: int) -> None:
        """Add the statements of a call with its results, and with what it writes through addresses."""
        place = m.TextPosition(line)
        targets = (*results, *passed.targets)
        call = m.Assign(targets, passed.call, place=place) if targets else m.Evaluate(passed.call, place=place)
        self.pending += [call, *passed.copies]

    def _arguments(self, function: CFunctionDeclaration, trees: Sequence[c_ast.Node], line: int) -> "_PassedArguments":
        """Return a call of a function of the file, and the targets of what it writes through addresses."""
        name = function.name
        if len(trees) != len(function.arguments):
            raise UnsupportedCError(f"{name} takes {len(function.arguments)} arguments, got {len(trees)}", wrong=True)
        targets: list[m.Expression] = []
        arguments: list[m.Expression] = []
        copies: list[m.Statement] = []
        passed: list[str] = []
        changed: list[str] = []
        for argument, tree in zip(function.arguments, trees, strict=True):
            if argument.mode == "value" and isinstance(argument.variable.type, CType):
                arguments.append(converted(self.operand(tree), argument.variable.type))
                continue
            # the targets are assigned behind the call, which may change variables in their indices
            places = [self.frozen(place, line) for place in self._passed(name, argument, tree)]
            names = [each for place in places for each in _names_of(place)]
            passed += names if argument.mode != "value" else []
            if argument.mode == "output":
                changed += names
                self.pending += [mark for place in places[:1] for mark in self.marked(place, line, keeps=True)]
            for place in places:
                part = self._packed(place, line)
                arguments.append(self.used(part) if argument.mode == "output" else self.value_of(part))
                if argument.mode == "output":
                    targets.append(self.used(part))
                    # the call writes to the copy of a part of an array
                    copies += [] if part is place else self._copied_back(part, place, line)
        self.passed.append(PassedNames(name, tuple(passed), tuple(changed), line))
        return _PassedArguments(m.Call(m.Name(f"{name}()"), tuple(arguments)), targets, copies)

    def _packed(self, place: CPlace, line: int) -> CPlace:
        """Return an array within an array, or a part of one, as a variable of its own; other places as they are."""
        if not place.sizes or (not place.indices and place.start is None):
            return place
        name, position = self.temporary(), m.TextPosition(line)
        if self._is_tail(place):
            # only where the function is called, the address must be known: a loop has another one in each pass
            start = place.start or m.Number(0.0)
            numbers = call_of("tail", self.used(_whole(place)), start, m.Number(float(bool(place.rows))))
        else:
            trees = [self.value_of(number) for number in single_numbers(place)]
            sizes = [m.Number(float(size)) for size in (len(place.sizes), len(trees), *place.sizes[1:])]
            numbers = call_of("array", *sizes, *trees)
        self.pending.append(m.Assign((m.Name(name),), numbers, place=position))
        return CPlace(CVariable(name, place.type, place.sizes), "", place.type, place.sizes)

    @staticmethod
    def _is_tail(place: CPlace) -> bool:
        """Return True for the elements of a whole array from an address on."""
        return place.start is not None and not place.indices and place.offset is None

    def _copied_back(self, part: CPlace, place: CPlace, line: int) -> list[m.Statement]:
        if self._is_tail(place):
            whole = self.used(_whole(place))
            value = call_of("with_tail", whole, part.tree)
            return [m.Assign((whole,), value, place=m.TextPosition(line))]
        pairs = zip(single_numbers(place), single_numbers(part), strict=True)
        return [m.Assign((self.used(to),), of.tree, place=m.TextPosition(line)) for to, of in pairs]

    def _passed(self, name: str, argument: CArgument, tree: c_ast.Node) -> list[CPlace]:
        """Return the places of the numbers whose addresses, or whose struct, an argument passes."""
        place = self.place(tree) if argument.mode == "value" else self.address(tree)
        variable = argument.variable
        if argument.mode != "value" and place.sizes and not variable.sizes:
            place = self.pointed(place, tree)
        if not same_type(place.type, variable.type):
            label = getattr(variable.type, "name", "something else")
            raise UnsupportedCError(f"{name} takes the address of {label} as {variable.name}", wrong=True)
        if len(place.sizes) != len(variable.sizes):
            expected = "an array" if variable.sizes else "a single object"
            raise UnsupportedCError(f"{name} takes the address of {expected} as {variable.name}", wrong=True)
        if place.is_constant and argument.mode == "output":
            raise UnsupportedCError(f"{place.label} is const, but {name} may change it", wrong=True)
        if place.offset is not None:
            if place.sizes or not isinstance(place.type, CType):
                raise UnsupportedCError(f"{place.label} is a part of a union, which cannot be passed")
            return [place]
        return [place.leaf(leaf) for leaf in place.leaves]


def _whole(place: CPlace) -> CPlace:
    """Return the array that an address leads into; of a matrix with its own sizes."""
    return replace(place.array, sizes=place.rows or place.sizes, rows=())


def changes_a_variable(tree: c_ast.Node) -> bool:
    """Return True if an expression has an assignment, or counts a variable up or down."""
    if isinstance(tree, c_ast.Assignment) or (isinstance(tree, c_ast.UnaryOp) and tree.op in _COUNTING):
        return True
    return any(changes_a_variable(child) for _, child in tree.children())


def _names_of(place: CPlace) -> Iterator[str]:
    """Yield the names by which a function that gets an address can change numbers: also those that overlap."""
    yield place.name
    yield from (part.tag(place.indices).name for part in place.unions)
