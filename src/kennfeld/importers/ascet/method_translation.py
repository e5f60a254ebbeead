"""Translation of ESDL methods to functions of the shared syntax tree."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.importers.ascet.c_methods import c_body, known_rule, required_c_file
from kennfeld.importers.ascet.call_translation import CallTranslation
from kennfeld.importers.ascet.expression_translation import call_of
from kennfeld.importers.ascet.instances import ClassInstance, history_label, state_label
from kennfeld.importers.ascet.name_resolution import EnumerationName
from kennfeld.importers.ascet.program_code import RESULT, MethodCode, Operand, Place, ProgramCode, leaf_names
from kennfeld.importers.ascet.resolved_types import (
    INTEGER,
    Dimension,
    NumberType,
    ResolvedArray,
    StructType,
    Type,
    describe_type,
    is_open,
    leaves_of,
    with_sizes,
)
from kennfeld.importers.ascet.state_machines import STATE, histories, history_name, machine_statements, state_numbers
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError, unsupported_error
from kennfeld.program import tree as m

_MAX_COPIES: Final = 10_000  # elements that an assignment copies one by one
_MAX_STATEMENTS: Final = 50_000  # of a method, after structs and arrays are split


class MethodTranslation(CallTranslation):
    """Translation of one method of an instance; statements that are not supported are reported and left out."""

    def __init__(self, code: ProgramCode, instance: ClassInstance, method: e.Method, name: str) -> None:
        super().__init__(code, instance)
        self.method, self.name = method, name
        self._taken: dict[str, int] = {}
        self._result: Type | None = None
        self._count = 0
        self._is_complete = True

    def translate(self, arguments: Sequence[Type | None]) -> MethodCode:
        """Translate the method for arguments of these types."""
        types, scope = self.program.types, self.instance.scope
        if self.method.result is not None:
            self._result = types.resolve(self.method.result, scope)
        parameters: list[str] = []
        for at, argument in enumerate(self.method.arguments):
            kind = arguments[at] if at < len(arguments) else None
            # numbers keep the type of the declaration; arrays have the sizes of this call
            place = self._declare(argument.name, kind or types.resolve(argument.type, scope))
            parameters += leaf_names(place.label, place.type)
        outputs = tuple(at for at, argument in enumerate(self.method.arguments) if argument.direction != "in")
        changed = [self.names.locals[0][self.method.arguments[at].name] for at in outputs]
        body = self._body()
        results = [] if self._result is None else leaf_names(RESULT, self._result)
        for place in changed:
            results += leaf_names(place.label, place.type)
        declaration = m.Declaration("global", tuple(sorted(self.used)), place=self.method.place)
        # without the statements that were left out, the others would compute something else
        statements = ((declaration, *body) if self.used else body) if self._is_complete else ()
        self.code.read |= self.used
        definition = m.FunctionDefinition(
            self.name, tuple(parameters), tuple(results), statements, place=self.method.place
        )
        return MethodCode(self.name, definition, scope, self._result, outputs, self._is_complete)

    def _body(self) -> m.Statements:
        if self.method.is_in_c:
            return self._body_in_c()
        if not self.method.triggers:
            return self.statements(self.method.body or (), is_last=True)
        machine = self.instance.machine(self.method.triggers)
        if machine is None:
            message = f"unknown state machine {self.method.triggers}"
            raise UnsupportedEsdlError(message, place=self.method.place)
        numbers = state_numbers(self.program.types, self.instance.scope, machine)
        variable = self.program.variables[state_label(self.instance, machine)]
        self.names.locals[0][STATE] = Place(variable.label, variable.type)
        for state in histories(machine):
            label = history_label(self.instance, machine, state)
            self.names.locals[0][history_name(state)] = Place(label, variable.type)
        return self.statements(machine_statements(machine, numbers, self.method.name))

    def _body_in_c(self) -> m.Statements:
        rule = known_rule(self.instance, self.method)
        if rule is not None:
            names = (e.Name(argument.name, place=argument.place) for argument in self.method.arguments)
            called = e.Call(e.Name(self.method.name), tuple(names), place=self.method.place)
            return self.statements((e.Return(called, place=self.method.place),), is_last=True)
        path = required_c_file(self.instance, self.method, self.method.place)
        body = c_body(self.instance, self.method, path)
        self.wraps = True
        self.code.files.setdefault(path)
        return self.statements(body, is_last=True)

    # statements

    def statements(self, statements: Sequence[e.Statement], is_last: bool = False) -> m.Statements:
        """Translate statements; unsupported ones are reported."""
        result: list[m.Statement] = []
        for at, statement in enumerate(statements, 1):
            try:
                translated = self._statement(statement, is_last and at == len(statements))
            except UnsupportedEsdlError as error:
                self.code.report(error, self.instance.scope, statement.place, f"{self._path()}")
                self._is_complete = False
                translated = ()
            result += [*self.pending, *translated]
            self.pending = []
            self._count += len(translated)
            if self._count > _MAX_STATEMENTS:
                raise UnsupportedEsdlError(f"{self.method.name} needs more than {_MAX_STATEMENTS} statements")
        return tuple(result)

    def _path(self) -> str:
        return f"{self.instance.declared.name}.{self.method.name}"

    def _block(self, statements: Sequence[e.Statement], is_last: bool = False) -> m.Statements:
        """Translate the statements of a block, whose variables are not known outside."""
        # what the condition needs stays before the block
        outer, self.pending = self.pending, []
        self.names.locals.append({})
        try:
            return self.statements(statements, is_last)
        finally:
            self.names.locals.pop()
            self.pending = outer

    def _statement(self, statement: e.Statement, is_last: bool) -> m.Statements:
        place = statement.place
        match statement:
            case e.Assign():
                return self._assign_statement(statement)
            case e.Declare(element):
                return self._declare_statement(element)
            case e.Evaluate(expression):
                return self._evaluate(expression)
            case e.If(condition, body, otherwise):
                branch = m.Branch(self.operand(condition).tree, self._block(body), place=place)
                return (m.If((branch,), self._block(otherwise), place=place),)
            case e.While():
                return self._while(statement)
            case e.For():
                return self._for(statement)
            case e.Switch():
                return self._switch(statement)
            case e.Return(value):
                return self._return(value, is_last, statement)
            case e.Jump(kind):
                return (m.Jump(kind, place=place),)
            case e.Block(statements):
                return self._block(statements, is_last)

    def _evaluate(self, expression: e.Expression) -> m.Statements:
        if isinstance(expression, e.Unsupported):
            raise unsupported_error(expression)
        if not isinstance(expression, e.Call):
            raise UnsupportedEsdlError("a call is required here", place=expression.place)
        result = self.call(expression)
        if isinstance(result, Operand) and isinstance(result.tree, m.Call):
            return (m.Evaluate(result.tree, place=expression.place),)
        return ()

    def _while(self, statement: e.While) -> m.Statements:
        place = statement.place
        condition = self.lazily(lambda: self.operand(statement.condition)).tree
        body = self._block(statement.body)
        loop = m.While(condition, body, place=place)
        if not statement.tests_last:
            return (loop,)
        if not _leaves_pass(body):
            return (*body, loop)  # the first pass comes before the first test
        # a jump of the first pass is one of this loop, too: while true: if not first: test; first = false; body
        first, yes = m.Name(self._free("first")), m.Number(1.0)
        leave = m.Branch(m.Unary("~", condition), (m.Jump("break", place=place),), place=place)
        test = m.If((m.Branch(m.Unary("~", first), (m.If((leave,), place=place),), place=place),), place=place)
        passed = m.Assign((first,), m.Number(0.0), place=place)
        return m.Assign((first,), yes, place=place), m.While(yes, (test, passed, *body), place=place)

    def _for(self, statement: e.For) -> m.Statements:
        first, last, kind = self._bounds(statement.values)
        self.names.locals.append({})
        try:
            # in a scope of its own: the variable of a loop hides others of its name until its end
            variable = self._declare(statement.name, kind)
            body = self._block(statement.body)
        finally:
            self.names.locals.pop()
        target = m.Name(variable.label)
        return (m.For(target, m.Range(first, None, last), body, place=statement.place),)

    def _bounds(self, values: e.Expression) -> tuple[m.Expression, m.Expression, NumberType]:
        """Return the first and the last value of a loop, and the type of its variable."""
        if isinstance(values, e.Range):
            if values.first is None or values.last is None:
                raise UnsupportedEsdlError("the range of a loop is open", place=values.place)
            first, last = self.operand(values.first), self.operand(values.last)
            return first.tree, last.tree, INTEGER
        if isinstance(values, e.Call) and isinstance(values.of, e.Field) and values.of.name == "indexRange":
            of = self.named(values.of.of)
            if not isinstance(of, Place) or not isinstance(of.type, ResolvedArray):
                raise UnsupportedEsdlError("indexRange of something that is not an array", place=values.place)
            dimension = of.type.dimensions[self._dimension(values, of.type.dimensions)]
            return *_ends(dimension, values), dimension.enumeration or INTEGER
        named = self.named(values)
        if isinstance(named, EnumerationName) and named.type.is_whole:
            kind = named.type
            return m.Number(kind.low), m.Number(kind.high), kind
        raise UnsupportedEsdlError("the values of a loop must be a range or a type", place=values.place)

    def _switch(self, statement: e.Switch) -> m.Statements:
        place = statement.place
        subject = self.operand(statement.subject)
        if statement.cases and not isinstance(subject.tree, m.Number):
            # evaluated once, although each case compares with it
            name = self._free("%switch")
            self.pending.append(m.Assign((m.Name(name),), subject.tree, place=place))
            subject = Operand(m.Name(name), subject.type)
        branches = tuple(
            m.Branch(self.matches(subject, keys), self._block(_without_break(body)), place=place)
            for keys, body in statement.cases
        )
        otherwise = self._block(_without_break(statement.otherwise))
        return (m.If(branches, otherwise, place=place),) if branches else otherwise

    def _return(self, value: e.Expression | None, is_last: bool, statement: e.Statement) -> m.Statements:
        result: list[m.Statement] = []
        if value is not None:
            if self._result is None:
                raise UnsupportedEsdlError(f"{self.method.name} is void, but returns a value", place=value.place)
            translated = self.value(value)
            # open sizes of the result are those of the value that is returned first
            if is_open(self._result) and isinstance(translated, Place):
                self._result = with_sizes(self._result, translated.type)
            target = Place(RESULT, self._result, is_local=True)
            result += self.assign(target, translated, value)
        # behind the last statement nothing is left to skip
        if not is_last:
            result.append(m.Jump("return", place=statement.place))
        return tuple(result)

    # variables

    def _free(self, name: str) -> str:
        """Return a name for a local variable that is not used yet in the function."""
        self._taken[name] = self._taken.get(name, 0) + 1
        return name if self._taken[name] == 1 else f"{name}#{self._taken[name]}"

    def _declare(self, name: str, kind: Type) -> Place:
        if not isinstance(kind, NumberType | StructType | ResolvedArray):
            raise UnsupportedEsdlError(f"the variable {name} is {describe_type(kind)}, which is not supported")
        place = Place(self._free(name), kind, is_local=True)
        self.names.locals[-1][name] = place
        return place

    def _declare_statement(self, element: e.Element) -> m.Statements:
        kind = self.program.types.element(element, self.instance.scope)
        value = self.value(element.value) if element.value is not None else None
        if is_open(kind) and isinstance(value, Place):
            kind = with_sizes(kind, value.type)
        place = self._declare(element.name, kind)
        shapes: list[m.Statement] = []
        for path, leaf, dimensions in leaves_of(kind):
            if not isinstance(leaf, NumberType):
                raise UnsupportedEsdlError(f"the variable {element.name} holds a table, which is not supported")
            sizes = [float(_size(dimension, element)) for dimension in dimensions]
            start = call_of("fill", m.Number(leaf.default), *map(m.Number, sizes)) if sizes else m.Number(leaf.default)
            shapes.append(m.Assign((m.Name(place.leaf(path)),), start, place=element.place))
        if value is None or element.value is None:
            return tuple(shapes)
        # a number that is assigned at once needs no value before
        if isinstance(kind, NumberType):
            shapes = []
        return (*shapes, *self.assign(place, value, element.value))

    def temporary(self, kind: Type, value: Place | e.Braces) -> Place:
        """Return a new local variable with the value."""
        element = e.Element(self._free("%value"), e.TypeName(""))
        place = Place(element.name, kind, is_local=True)
        for path, _, dimensions in leaves_of(kind):
            if sizes := [m.Number(float(_size(dimension, element))) for dimension in dimensions]:
                # an array has its size before its elements are assigned
                start = call_of("fill", m.Number(0.0), *sizes)
                self.pending.append(m.Assign((m.Name(place.leaf(path)),), start))
        self.pending += self.assign(place, value, value if isinstance(value, e.Braces) else e.Name(place.label))
        return place

    def _assign_statement(self, statement: e.Assign) -> m.Statements:
        target = self.named(statement.target)
        if not isinstance(target, Place):
            raise UnsupportedEsdlError("the target of an assignment is not a variable", place=statement.target.place)
        if target.is_fixed:
            message = f"{target.leaf()} is a constant or characteristic; it cannot be assigned"
            raise UnsupportedEsdlError(message, place=statement.target.place)
        value = statement.value
        if statement.operator:
            # v[next()] += 1 calls next() once: it is read and assigned at one index
            target = replace(target, indices=tuple(self.once(index, statement.place) for index in target.indices))
            left, right = self.read(target, statement.target), self.operand(value)
            return self.assign(target, self.combined(statement.operator, left, right, statement.place), value)
        return self.assign(target, self.value(value), value)

    def assign(self, target: Place, value: Operand | Place | e.Braces, tree: e.Expression) -> m.Statements:
        """Return the statements that assign a value to a variable or a part of it."""
        self.note_assigned(target)
        if isinstance(value, e.Braces):
            return self._assign_braces(target, value)
        place = tree.place
        if isinstance(target.type, NumberType):
            operand = value if isinstance(value, Operand) else self.read(value, tree)
            converted = self.converted(operand, target.type)
            return (m.Assign((self._target(target),), converted, place=place),)
        if isinstance(value, Operand):
            raise UnsupportedEsdlError(f"a number is assigned to {describe_type(target.type)}", place=tree.place)
        return self._copy(target, value, tree)

    def _target(self, place: Place, path: tuple[str, ...] = (), more: tuple[m.Expression, ...] = ()) -> m.Expression:
        name, indices = place.leaf(path), (*place.indices, *more)
        return m.Call(m.Name(name), indices) if indices else m.Name(name)

    def _copy(self, target: Place, source: Place, tree: e.Expression) -> m.Statements:
        """Return the statements that copy structs and arrays."""
        # by fields and not by order: a struct of another name may have the same fields
        theirs = {path: dimensions for path, _, dimensions in leaves_of(source.type)}
        result: list[m.Statement] = []
        for path, _, dimensions in leaves_of(target.type):
            if path not in theirs or _sizes(theirs[path]) != _sizes(dimensions):
                raise UnsupportedEsdlError(
                    f"{describe_type(source.type)} is assigned to {describe_type(target.type)} of another form",
                    place=tree.place,
                )
            place = tree.place
            # whole arrays are copied as one; parts of arrays number by number, as indices select elements of the leaves
            if not target.indices and not source.indices:
                value = self.leaf_tree(source, path)
                result.append(m.Assign((self._target(target, path),), value, place=place))
                continue
            for indices in self._all_indices(dimensions, tree):
                self.leaf_tree(source, path)  # notes its use
                value = self._target(source, path, indices)
                result.append(m.Assign((self._target(target, path, indices),), value, place=place))
        return tuple(result)

    def _all_indices(self, dimensions: Sequence[Dimension], tree: e.Expression) -> list[tuple[m.Expression, ...]]:
        sizes = _sizes(dimensions)
        count = 1
        for size in sizes:
            count *= size or 0
        if None in sizes or count > _MAX_COPIES:
            raise UnsupportedEsdlError("an array of an unknown or large size is copied", place=tree.place)
        # the interpreter of imperative code counts from 1, as MATLAB does, ESDL from 0
        ranges = [range(1, (size or 0) + 1) for size in sizes]
        return [tuple(m.Number(float(at)) for at in indices) for indices in product(*ranges)]

    def _assign_braces(self, target: Place, value: e.Braces) -> m.Statements:
        parts: list[Place] = []
        match target.type:
            case StructType(_, elements):
                for name, kind in elements:
                    fields = (*target.fields, name)
                    parts.append(Place(target.label, kind, fields, target.indices, target.is_local))
            case ResolvedArray(dimensions, element):
                first, *rest = dimensions
                kind = ResolvedArray(tuple(rest), element) if rest else element
                for at in range(first.size or 0):
                    indices = (*target.indices, m.Number(at + 1.0))
                    parts.append(Place(target.label, kind, target.fields, indices, target.is_local))
            case _:
                raise UnsupportedEsdlError("elements in { } are assigned to a number", place=value.place)
        if len(value.elements) > len(parts):
            raise UnsupportedEsdlError(f"{len(value.elements)} elements, expected {len(parts)}", place=value.place)
        result: list[m.Statement] = []
        for part, item in zip(parts, value.elements, strict=False):
            result += self.assign(part, self.value(item), item)
        return tuple(result)


def translate_method(
    code: ProgramCode, instance: ClassInstance, method: e.Method, name: str, arguments: Sequence[Type | None]
) -> MethodCode:
    """Return a method of an instance as a function of this name, for arguments of these types."""
    return MethodTranslation(code, instance, method, name).translate(arguments)


def _ends(dimension: Dimension, tree: e.Expression) -> tuple[m.Expression, m.Expression]:
    if dimension.size is None:
        raise UnsupportedEsdlError("the size of the array is not known here", place=tree.place)
    return m.Number(float(dimension.first)), m.Number(float(dimension.first + dimension.size - 1))


def _size(dimension: Dimension, element: e.Element) -> int:
    if dimension.size is None:
        raise UnsupportedEsdlError(f"the array {element.name} has no size", place=element.place)
    return dimension.size


def _sizes(dimensions: Sequence[Dimension]) -> list[int | None]:
    return [dimension.size for dimension in dimensions]


def _without_break(body: e.Statements) -> e.Statements:
    """Return the statements of a case without the `break`s that end it, perhaps under conditions or within blocks.

    What follows a statement that may end the case moves to where it does not.
    """
    for at, statement in enumerate(body):
        before, rest = body[:at], body[at + 1 :]
        match statement:
            case e.Jump("break"):
                return before
            case e.If(_, inner, otherwise) if _break_in((statement,)):
                yes, no = (_without_break(_continued(branch, rest)) for branch in (inner, otherwise))
                return (*before, replace(statement, body=yes, otherwise=no))
            case e.Block(inner) if _break_in((statement,)):
                return (*before, replace(statement, statements=_without_break(_continued(inner, rest))))
    return body


def _continued(inner: e.Statements, rest: e.Statements) -> e.Statements:
    """Return statements with those behind them, which must not see the variables that the former declare."""
    declared = next((statement for statement in inner if isinstance(statement, e.Declare)), None)
    is_ended = any(statement == e.Jump("break", place=statement.place) for statement in inner)
    if declared is not None and rest and not is_ended:
        message = "a break beside the declaration of a variable that does not end its case is not supported"
        raise UnsupportedEsdlError(message, "Declare the variable before the case.", declared.place)
    return (*inner, *rest)


def _break_in(body: e.Statements) -> bool:
    """Return True if there is a `break` that is not one of a loop or a switch within the statements."""
    for statement in body:
        match statement:
            case e.Jump("break"):
                return True
            case e.If(_, inner, otherwise) if _break_in((*inner, *otherwise)):
                return True
            case e.Block(inner) if _break_in(inner):
                return True
    return False


def _leaves_pass(statements: m.Statements) -> bool:
    """Return True if statements may jump out of the pass of the loop around them."""
    for statement in statements:
        match statement:
            case m.Jump("break" | "continue"):
                return True
            case m.If(branches, otherwise) | m.Switch(_, branches, otherwise):
                if any(map(_leaves_pass, (otherwise, *(branch.body for branch in branches)))):
                    return True
    return False
