"""Translation of C functions to functions of the shared syntax tree."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from pycparser import c_ast

from kennfeld.importers.c.call_translation import changes_a_variable
from kennfeld.importers.c.declarations import (
    RESULT,
    CFile,
    CFunctionDeclaration,
    CVariable,
    StaticVariable,
    line_of,
    variable_of,
)
from kennfeld.importers.c.expression_translation import COperand, converted
from kennfeld.importers.c.initial_values import count_elements
from kennfeld.importers.c.number_types import CType, UnsupportedCError
from kennfeld.importers.c.places import CPlace, Scope
from kennfeld.importers.c.pointer_choices import PointerChoices, nodes_of
from kennfeld.importers.c.struct_types import CStructType, enumeration_constants, enumerations
from kennfeld.program import tree as m

_YES: Final = m.Number(1.0)
_NO: Final = m.Number(0.0)
_SILENT: Final = frozenset({"printf", "assert", "puts", "fprintf", "fflush"})


class FunctionTranslation(PointerChoices):
    """Translates one function; `statics` are the static variables that it declares."""

    def __init__(self, file: CFile, function: CFunctionDeclaration, shared: Scope) -> None:
        super().__init__(file, function, shared)
        self.statics: list[StaticVariable] = []
        self._declared: dict[int, CVariable] = {}
        self._taken: dict[str, int] = {}
        self._addressed = set(_addressed(function.tree.body))
        self._reassigned = set(_reassigned(function.tree.body))

    def translate(self) -> m.FunctionDefinition:
        """Translate the function to the shared syntax tree."""
        start: list[m.Statement] = []
        for argument in self.function.arguments:
            start += self.declare_argument(argument.variable)
            self._taken[argument.variable.name] = 1
            self.note_precision(argument.variable.type)
        body = (*start, *self.block(self.function.tree.body.block_items or ()))
        # variables that keep their values are global names of the shared tree
        head = (m.Declaration("global", tuple(self.statics_used)),) if self.statics_used else ()
        written = (name for argument in self.function.outputs for name in argument.names)
        # the tree has no addresses: what is written through them is returned behind the result
        results = [*self.function.result_names, *written]
        names = tuple(name for argument in self.function.arguments for name in argument.names)
        return m.FunctionDefinition(f"{self.function.name}()", names, tuple(results), (*head, *body))

    # statements

    def _body(self, tree: c_ast.Node | None) -> tuple[m.Statement, ...]:
        if tree is None:
            return ()
        return self.block(tree.block_items or () if isinstance(tree, c_ast.Compound) else (tree,))

    def statement(self, tree: c_ast.Node) -> list[m.Statement]:
        place = m.TextPosition(line_of(tree))
        match tree:
            case c_ast.EmptyStatement() | c_ast.Pragma():
                return []
            case c_ast.Typedef():
                self.file.types.typedef(tree)
                return []
            case c_ast.Compound():
                return list(self._body(tree))
            case c_ast.Decl() | c_ast.DeclList():
                return self._declarations(tree)
            case c_ast.Assignment():
                return [] if self.set_pointer(tree) else self.assignment(tree)
            case c_ast.UnaryOp(op=("++" | "--" | "p++" | "p--") as op, expr=target):
                return [] if self.set_pointer(tree) else [self.stepped(op, target, place.line)]
            case c_ast.ExprList(exprs=exprs):
                return [statement for expr in exprs for statement in self.statement(expr)]
            case c_ast.FuncCall():
                return self._call_statement(tree)
            case c_ast.If(cond=condition, iftrue=yes, iffalse=no):
                tested = self.condition(condition).tree
                # those of the condition: the first statement of the body would take them
                pending, self.pending = self.pending, []
                branch = m.Branch(tested, self._body(yes), place=place)
                return [*pending, m.If((branch,), self._body(no), place=place)]
            case c_ast.For() | c_ast.While() | c_ast.DoWhile():
                return self._loop(tree)
            case c_ast.Switch():
                return self._switch(tree)
            case c_ast.Label(stmt=labelled):  # where no goto leads
                return self.statement(labelled)
            case c_ast.Break():
                return [m.Jump("break", place=place)]
            case c_ast.Continue():
                return [m.Jump("continue", place=place)]
            case c_ast.Return(expr=value):
                return self._return(value, place)
            case c_ast.Cast(expr=c_ast.FuncCall() as call):
                return self._call_statement(call)
            case c_ast.Cast() | c_ast.ID():  # (void)x
                return []
        raise UnsupportedCError(f"{_statement_name(tree)} is not supported", line_of(tree))

    def _call_statement(self, tree: c_ast.FuncCall) -> list[m.Statement]:
        name = getattr(tree.name, "name", "")
        if name in _SILENT:
            if tree.args is not None and changes_a_variable(tree.args):
                message = f"a variable that changes within the arguments of {name} is not supported"
                raise UnsupportedCError(message, line_of(tree))
            return []
        if name in ("memset", "memcpy") and name not in self.file.functions:
            return self.memory_call(name, tree)
        operand: COperand | None = None
        declared = self.file.functions.get(name)
        if declared is not None and isinstance(declared.result, CStructType):
            self.called_struct(tree)
        else:
            operand = self.call(tree, wants_result=False)
        pending, self.pending = self.pending, []
        # a result in a temporary variable: its call is among the statements that wait
        calls = [] if operand is None or isinstance(operand.tree, m.Name) else [m.Evaluate(operand.tree)]
        return [*pending, *calls]

    def _return(self, value: c_ast.Node | None, place: m.TextPosition) -> list[m.Statement]:
        jump = m.Jump("return", place=place)
        if self.function.passed_back in self._reassigned:
            raise UnsupportedCError(f"{self.function.name} returns an address that it sets")
        if self.function.result is None:
            return [jump]
        if value is None:
            raise UnsupportedCError(f"{self.function.name} must return a value", wrong=True)
        if isinstance(self.function.result, CStructType):
            result = CPlace(CVariable(RESULT, self.function.result), "", self.function.result)
            return [*self.copied(result, self.place(value), place.line), jump]
        self.note_precision(self.function.result)
        number = converted(self.operand(value), self.function.result)
        return [m.Assign((m.Name(RESULT),), number, place=place), jump]

    # declarations

    def _declarations(self, tree: c_ast.Node) -> list[m.Statement]:
        declarations = tree.decls if isinstance(tree, c_ast.DeclList) else [tree]
        result: list[m.Statement] = []
        for item in declarations:
            for enumeration in enumerations(item):
                self.scopes[-1] |= enumeration_constants(enumeration, self.file.types.constants)
            if item.name and not isinstance(item.type, c_ast.FuncDecl):
                result += self._declared_or_noted(item)
        return result

    def _declared_or_noted(self, tree: c_ast.Decl) -> list[m.Statement]:
        """Declare a variable; note why that fails, for those who name it."""
        try:
            return self._declare(tree)
        except UnsupportedCError as error:
            reason = UnsupportedCError(error.message, error.line or line_of(tree), wrong=error.wrong)
            self.scopes[-1][tree.name] = reason
            raise reason from None

    def _declare(self, tree: c_ast.Decl) -> list[m.Statement]:
        is_static = "static" in tree.storage
        # a pointer is not stored: its name stands for the place that it leads to
        if isinstance(tree.type, c_ast.PtrDecl) and not is_static:
            self.declare_pointer(tree)
            return []
        if is_static and id(tree) in self._declared:  # by the first of several translations
            self.scopes[-1][tree.name] = self._declared[id(tree)]
            return []
        self._taken[tree.name] = self._taken.get(tree.name, 0) + 1
        # a variable of an inner block may hide one of the same name: a number keeps both apart
        number = self._taken[tree.name]
        name = tree.name if number == 1 else f"{tree.name}#{number}"
        # static variables of several functions may have the same name
        owned = f"{self.function.name}().{name}" if is_static else name
        variable = variable_of(tree, owned, self.file, count_elements(tree.init, self.file.types.constants))
        if is_static:
            self.statics += self.static_parts(tree, variable, f"{self.function.name}.{tree.name}")
            self.scopes[-1][tree.name] = self._declared[id(tree)] = variable
            return []
        statements = self._first_assignments(tree, variable)
        self.note_precision(variable.type)
        self.scopes[-1][tree.name] = variable
        return statements

    def _first_assignments(self, tree: c_ast.Decl, variable: CVariable) -> list[m.Statement]:
        """Return the statements that give a local variable its first values."""
        line = line_of(tree)
        is_number = isinstance(variable.type, CType) and not variable.sizes
        if tree.init is not None and not is_number and not isinstance(tree.init, c_ast.InitList):
            # a const variable as well gets its first value by an assignment
            self.scopes[-1][tree.name] = replace(variable, is_constant=False)
            return self.copied(self.place(c_ast.ID(tree.name)), self.place(tree.init), line)
        # stays unassigned, so that reading it too early is reported; one whose address is taken needs a number
        if tree.init is None and is_number and tree.name not in self._addressed:
            return []
        return self.first_assignments(tree, variable)

    def static_parts(self, tree: c_ast.Decl, variable: CVariable, label: str) -> list[StaticVariable]:
        """Return the numbers of a variable that keeps its values."""
        is_initialized, line = tree.init is not None, line_of(tree)
        return [
            StaticVariable(f"{variable.name}{leaf.path}", leaf, value, variable, label, is_initialized, line)
            for leaf, value in self.first_values(tree, variable)
        ]

    # loops

    def _loop(self, tree: c_ast.Node) -> list[m.Statement]:
        self.scopes.append({})
        start: list[m.Statement] = []
        if isinstance(tree, c_ast.For) and tree.init is not None:
            start = self.with_pending(lambda: self.statement(tree.init))
            for part in (tree.cond, tree.stmt, tree.next):  # an address of the first pass may not be that of the second
                if part is not None:
                    self.forget_pointers(part)
        end = self._loop_end(tree)
        body = self._body(tree.stmt)
        step: list[m.Statement] = []
        if isinstance(tree, c_ast.For) and tree.next is not None:
            step = self.with_pending(lambda: self.statement(tree.next))
        self.scopes.pop()
        if isinstance(tree, c_ast.DoWhile):
            return [*start, *self._again(tree, end, body, ())]
        # a plain loop: the condition needs no statements before it, and `continue` cannot skip the step
        if len(end) == 1 and not (step and _has_jump(tree.stmt, c_ast.Continue)):
            (statement,) = end
            assert isinstance(statement, m.If)
            condition = statement.branches[0].condition
            assert isinstance(condition, m.Unary)
            return [*start, m.While(condition.operand, (*body, *step), place=statement.place)]
        return [*start, *self._again(tree, end, body, step, tests_first=True)]

    def _loop_end(self, tree: c_ast.Node) -> list[m.Statement]:
        """Return the statements that leave a loop if its condition does not hold."""
        place = m.TextPosition(line_of(tree))

        def translate() -> list[m.Statement]:
            holds = _YES if tree.cond is None else self.condition(tree.cond).tree
            leave = m.Branch(m.Unary("~", holds), (m.Jump("break", place=place),), place=place)
            return [m.If((leave,), place=place)]

        return self.with_pending(translate)

    def _again(
        self,
        tree: c_ast.Node,
        end: Sequence[m.Statement],
        body: Sequence[m.Statement],
        step: Sequence[m.Statement],
        *,
        tests_first: bool = False,
    ) -> list[m.Statement]:
        """Return a loop whose end is tested within it; all passes but the first one begin with `step`."""
        place, first = m.TextPosition(line_of(tree)), m.Name(self.temporary())
        before = (*step, *(() if tests_first else end))
        # while 1: if not first: step, test (do-while); first = 0; test (for, while); body.
        # `continue` leads to the head of the loop, so that step and test come there
        again = m.If((m.Branch(m.Unary("~", first), before, place=place),), place=place)
        entered = m.Assign((first,), _NO, place=place)
        tested = end if tests_first else ()
        return [
            m.Assign((first,), _YES, place=place),
            m.While(_YES, (again, entered, *tested, *body), place=place),
        ]

    # switch

    def _switch(self, tree: c_ast.Switch) -> list[m.Statement]:
        place = m.TextPosition(line_of(tree))
        subject = self.operand(tree.cond)
        name = self.temporary()
        pending, self.pending = self.pending, []
        # evaluated once, although each case compares with it
        head: list[m.Statement] = [*pending, m.Assign((m.Name(name),), subject.tree, place=place)]
        cases = tree.stmt.block_items or () if isinstance(tree.stmt, c_ast.Compound) else ()
        if not all(isinstance(case, c_ast.Case | c_ast.Default) for case in cases):
            raise UnsupportedCError("statements of a switch outside of its cases", line_of(tree))
        branches: list[m.Branch] = []
        otherwise: tuple[m.Statement, ...] = ()
        keys: list[m.Expression] = []
        is_default = False
        for at, case in enumerate(cases):
            is_default |= isinstance(case, c_ast.Default)
            if isinstance(case, c_ast.Case):
                keys.append(m.Binary("==", m.Name(name), self.operand(case.expr).tree))
            # `case 1: case 2:` share the statements behind the last of them
            if not case.stmts and at + 1 < len(cases):
                continue
            self.forget_pointers(tree)  # that other cases set
            body = self._case(_followed(cases[at:]), place)
            if is_default:
                otherwise = body  # where its other keys lead as well
            else:
                branches.append(m.Branch(_any(keys), body, place=place))
            keys, is_default = [], False
        whole: list[m.Statement] = [m.If(tuple(branches), otherwise, place=place)] if branches else list(otherwise)
        return [*head, *whole]

    def _case(self, statements: Sequence[c_ast.Node], place: m.TextPosition) -> tuple[m.Statement, ...]:
        """Translate the statements of a case; with a break under a condition, as a loop of one pass."""
        body = self.block(statements)
        if not any(_has_jump(statement, c_ast.Break) for statement in statements):
            return body
        if any(_has_jump(statement, c_ast.Continue) for statement in statements):
            raise UnsupportedCError("a case with both break and continue under conditions is not supported", place.line)
        return (m.While(_YES, (*body, m.Jump("break", place=place)), place=place),)


def translate_shared(file: CFile) -> tuple[Scope, list[StaticVariable], list[UnsupportedCError]]:
    """Return the variables of a file outside of its functions, with their first values.

    The problems are those of variables that cannot be read, which matter only if a function uses them.
    """
    scope: Scope = {}
    statics: list[StaticVariable] = []
    problems: list[UnsupportedCError] = []
    empty = c_ast.FuncDef(None, None, c_ast.Compound([]))
    translation = FunctionTranslation(file, CFunctionDeclaration("", empty, (), None), scope)
    # addresses after the variables that they lead to
    for name, tree in sorted(file.variables.items(), key=lambda item: isinstance(item[1].type, c_ast.PtrDecl)):
        try:
            if isinstance(tree.type, c_ast.PtrDecl):
                if tree.init is None:
                    raise UnsupportedCError(f"the pointer {name} must be set where it is declared")
                scope[name] = translation.address(tree.init)
                continue
            elements = count_elements(tree.init, file.types.constants)
            # the dot keeps variables of the file apart from local ones of the same name
            variable = replace(variable_of(tree, f".{name}", file, elements), is_static=True)
            statics += translation.static_parts(tree, variable, name)
            scope[name] = variable
        except UnsupportedCError as error:
            problems.append(UnsupportedCError(error.message, error.line or line_of(tree), wrong=error.wrong, name=name))
    return scope, statics, problems


def _any(keys: Sequence[m.Expression]) -> m.Expression:
    result = keys[0]
    for key in keys[1:]:
        result = m.Binary("|", result, key)
    return result


def _followed(cases: Sequence[c_ast.Node]) -> list[c_ast.Node]:
    """Return the statements from a case up to the `break` that ends it, with those of the cases it falls into."""
    result: list[c_ast.Node] = []
    for case in cases:
        statements = list(case.stmts or ())
        if len(statements) == 1 and isinstance(statements[0], c_ast.Compound):
            statements = list(statements[0].block_items or ())
        for statement in statements:
            if isinstance(statement, c_ast.Break):
                return result
            result.append(statement)
            if isinstance(statement, c_ast.Return | c_ast.Continue):
                return result
    return result


def _has_jump(tree: c_ast.Node | None, kind: type[c_ast.Node]) -> bool:
    """Return True if a jump within a statement leaves it, other than those of loops in it."""
    if tree is None:
        return False
    if isinstance(tree, kind):
        return True
    # `break` in an inner switch ends that one, `continue` in it the loop around
    inner = (c_ast.For, c_ast.While, c_ast.DoWhile, *((c_ast.Switch,) if kind is c_ast.Break else ()))
    return any(_has_jump(child, kind) for _, child in tree.children() if not isinstance(child, inner))


def _addressed(tree: c_ast.Node) -> Iterator[str]:
    """Yield the names of variables whose addresses are taken, and of structs."""
    for node in nodes_of(tree):
        if isinstance(node, c_ast.UnaryOp) and node.op == "&":
            of = node.expr
            while isinstance(of, c_ast.StructRef | c_ast.ArrayRef):
                of = of.name
            if isinstance(of, c_ast.ID):
                yield str(of.name)


def _reassigned(tree: c_ast.Node) -> Iterator[str]:
    """Yield the names of variables that are assigned as a whole behind their declaration."""
    for node in nodes_of(tree):
        target = node.lvalue if isinstance(node, c_ast.Assignment) else None
        if isinstance(node, c_ast.UnaryOp) and node.op in ("++", "--", "p++", "p--"):
            target = node.expr
        if isinstance(target, c_ast.ID):
            yield str(target.name)


def _statement_name(tree: c_ast.Node) -> str:
    return {"Goto": "goto", "Case": "a case"}.get(type(tree).__name__, type(tree).__name__)
