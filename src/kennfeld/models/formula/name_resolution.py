"""Name resolution of formula text: nodes, parameters, inputs, functions and constants, and all errors about names."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Literal, NamedTuple, TypeVar

from kennfeld.base.errors import Location
from kennfeld.base.formatting import nearest
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.graph import CLOCK
from kennfeld.graph.node import NEXT_STEP, STEP, TIME
from kennfeld.models.formula.functions import CONSTANTS, FUNCTIONS
from kennfeld.models.formula.functions import BuiltinFunction as BuiltIn
from kennfeld.models.formula.lexer import RESERVED, Source
from kennfeld.models.formula.syntax import (
    Call,
    Chain,
    Declaration,
    Definition,
    Expr,
    FunctionDefinition,
    Name,
    Prefix,
    SolverDeclaration,
    Statement,
    Token,
)

_S = TypeVar("_S", Definition, FunctionDefinition, Declaration)
Kind = Literal["clock", "constant", "node", "parameter", "input"]

_AXES: Mapping[str, tuple[int, ...]] = {"scalar": (0,), "curve": (1,), "map": (2,), "cube": (3, 4)}
_KINDS = {1: "Curve", 2: "Map"}  # class of a table by its number of coordinates
_CLOCKS = {STEP: "step", NEXT_STEP: "next step", TIME: "time"}
_TABLE_KINDS = ("curve", "map", "cube", "rbf")
_TABLES = {0: "a scalar", 1: "a curve", 2: "a map", 3: "a cube", 4: "a cube"}


class NameScope(NamedTuple):
    """The names to which a text may refer in addition to its own definitions.

    `parameters` None means that they are unknown: a name that is called is a table. `axes` are their numbers of axes,
    if known; `inputs` are existing inputs. `channels` None means that any other name is an input. `owner` names the
    model of the parameters in messages; `functions` are called like built-in ones. `table_remedy` says how to define an
    unknown table, with the fields `kind` and `name`.
    """

    nodes: Mapping[str, int] = FrozenDict({})
    parameters: Collection[str] | None = None
    axes: Mapping[str, int] = FrozenDict({})
    inputs: Collection[str] = ()
    channels: Collection[str] | None = None
    owner: str = "this project"
    functions: Mapping[str, BuiltIn] = FrozenDict({})
    table_remedy: str = ""


def children(expr: Expr) -> Sequence[Expr]:
    """Return the direct parts of an expression, from left to right."""
    match expr:
        case Call():
            return expr.args
        case Chain():
            return (expr.first, *(operand for _, operand in expr.rest))
        case Prefix():
            return (expr.operand,)
    return ()


def walk(expr: Expr) -> Iterator[Expr]:
    """Yield an expression and all its parts, in the order of the text."""
    stack = [expr]
    while stack:
        yield (at := stack.pop())
        stack.extend(reversed(children(at)))


class NameTable:
    """The resolved names of a text; the constructor reports all errors to the source.

    `definitions` and `functions` hold the statements, `uses` the first use of each parameter or input, `axes` the
    number of coordinates of each parameter, `broken` the keys of statements that cannot be lowered.
    """

    def __init__(self, statements: Sequence[Statement], around: NameScope, source: Source) -> None:
        known, channels = around.parameters, around.channels
        self.around = around._replace(  # dictionaries, because a project may know thousands of names
            parameters=None if known is None else dict.fromkeys(known),
            channels=None if channels is None else dict.fromkeys(channels),
        )
        self.source = source
        self.definitions: dict[str, Definition] = {}
        self.functions: dict[str, FunctionDefinition] = {}
        self.inputs: dict[str, Declaration] = {}
        self.outputs: dict[str, Declaration] = {}
        self.declared: dict[str, Declaration] = {}
        self.solver = next((s.solver for s in statements if isinstance(s, SolverDeclaration)), "")
        self.uses: dict[str, Token] = {}
        self.axes: dict[str, int] = dict(around.axes)
        self.broken: set[str] = set()
        self._called: dict[str, Token] = {}
        self._bare: dict[str, Token] = {}
        for statement in statements:
            self._register(statement)
        self._check_names()
        self._check_expressions()
        self._check_outputs()

    def kind(self, name: str, quoted: bool) -> Kind:
        """Return the kind of a bare name."""
        if not quoted and name in CLOCK:
            return "clock"
        if not quoted and name in CONSTANTS:
            return "constant"
        if name in self.definitions or name in self.around.nodes:
            return "node"
        if name in self.inputs:  # a set of a whole control unit may have a parameter of that name
            return "input"
        if name in self.declared or name in (self.around.parameters or ()):
            return "parameter"
        return "input"

    @property
    def undeclared(self) -> frozenset[str]:
        """The bare names that are parameters or inputs only because of what is known, and not by a declaration.

        A text that declares inputs declares all of them.
        """
        if self.inputs:
            return frozenset()
        return frozenset(name for name in self.uses if name not in self.declared and not self.axes.get(name))

    def built_in(self, call: Call) -> BuiltIn | None:
        """Return the built-in function of a call, or None if the text defines it."""
        if call.at.quoted:
            return None
        return FUNCTIONS.get(call.name) or self.around.functions.get(call.name)

    def _register(self, statement: Statement) -> None:
        match statement:
            case Definition():
                self._once(self.definitions, statement, "node")
            case FunctionDefinition():
                self._once(self.functions, statement, "function")
            case Declaration("input"):
                self._once(self.inputs, statement, "input")
            case Declaration("output"):
                self._once(self.outputs, statement, "output")
            case Declaration():
                self._once(self.declared, statement, "parameter")

    def _once(self, known: dict[str, _S], statement: _S, kind: str) -> None:
        first = known.setdefault(statement.at.name, statement)
        if first is not statement:
            where = self.source.location(first.at.line)
            self.source.report(statement.at, f"duplicate {kind} {statement.at.name}, first in {where}", "Remove one.")

    def _check_names(self) -> None:
        for name, definition in self.definitions.items():
            for kind, taken in (("a node", self.around.nodes), ("an input", self.around.inputs)):
                if name in taken:
                    message = f"{name} is already {kind} of {self.around.owner}"
                    self._report(name, definition.at, message, "Give it another name.")
        self._check_functions()
        everything: tuple[tuple[str, Mapping[str, Definition | FunctionDefinition | Declaration]], ...] = (
            ("a node", self.definitions),
            ("a function", self.functions),
            ("a parameter", self.declared),
            ("an input", self.inputs),
        )
        for index, (kind, known) in enumerate(everything):
            for name, statement in known.items():
                others = [other for other, names in everything[:index] if name in names]
                # a declaration of a known parameter confirms it, one of an input says that the parameter is not meant
                declared = known is self.declared or known is self.inputs
                if not declared and name in (self.around.parameters or ()):
                    others.append(f"a parameter of {self.around.owner}")
                if others:
                    message = f"{name} is both {kind} and {others[0]}"
                    self._report(name, statement.at, message, "Rename one of them.")

    def _check_functions(self) -> None:
        for name, function in self.functions.items():
            if function.at.quoted or name in FUNCTIONS:
                message = "a quoted name" if function.at.quoted else f"the built-in name {name}"
                self._report(name, function.at, f"{message} cannot be defined as a function", "Use another name.")
            names = [argument.name for argument in function.arguments]
            for index, argument in enumerate(function.arguments):
                if argument.name in names[:index]:
                    self._report(name, argument, f"duplicate argument {argument.name}", "Rename one of them.")

    def _report(self, name: str, at: Token, message: str, remedy: str = "") -> None:
        self.broken.add(name)
        self.source.report(at, message, remedy)

    def _check_expressions(self) -> None:
        everything: Iterable[tuple[str, Definition | FunctionDefinition]]
        everything = chain(self.definitions.items(), self.functions.items())
        for name, statement in everything:
            arguments: set[str] = set()
            if isinstance(statement, FunctionDefinition):
                arguments = {argument.name for argument in statement.arguments}
            if statement.value is None:
                self.broken.add(name)
                continue
            for part in walk(statement.value):
                if isinstance(part, Name) and part.name not in arguments:
                    self._check_bare(name, part)
                elif isinstance(part, Call):
                    self._check_call(name, part, arguments)
        for name in self._called.keys() & self._bare.keys() - self.broken:
            message = f"{name} is used as a table in {self._location(self._called[name])}, but without coordinates here"
            self._report(name, self._bare[name], message, f"Write {name}(...) with its coordinates.")

    def _location(self, token: Token) -> Location:
        return self.source.location(token.line, token.column)

    def _check_bare(self, owner: str, use: Name) -> None:
        name = use.name
        if not use.at.quoted and name in RESERVED:
            if name == "if":
                self._report(owner, use.at, "if requires parentheses", "Write if(condition, a, b).")
            return
        match self.kind(name, use.at.quoted):
            case "parameter":
                self._check_axes(owner, name, 0, use.at)
            case "input" if name in self.functions:
                arguments = ", ".join(argument.name for argument in self.functions[name].arguments)
                self._report(owner, use.at, f"{name} is a function of this text", f"Write {name}({arguments}).")
            case "input":
                self._check_input(owner, name, use.at)

    def _check_input(self, owner: str, name: str, at: Token) -> None:
        if name in CLOCK:  # quoted
            message = f"an input cannot have the name {name}, which is that of the {_CLOCKS[name]}"
            self._report(owner, at, message, "Give the input another name, and assign the channel in [channels].")
            return
        self.uses.setdefault(name, at)
        self._bare.setdefault(name, at)
        if self.around.channels is not None:
            if name not in self.around.channels:
                self._report(owner, at, f"unknown channel {name}", nearest(name, self.around.channels))
        # a text that declares inputs declares all of them, so that misspelt names are found
        elif self.inputs and name not in self.inputs:
            candidates = {**self.inputs, **self.definitions, **self.declared}
            remedy = nearest(name, [*candidates, *(self.around.parameters or ())]) or f"Declare it: input {at.text}."
            self._report(owner, at, f"unknown name {name}: not a node, a parameter or a declared input", remedy)

    def _check_call(self, owner: str, call: Call, arguments: Collection[str]) -> None:
        name, count = call.name, len(call.args)
        # arguments hide all other names
        if not call.at.quoted and name in arguments:
            self._report(owner, call.at, f"{name} is an argument, not a table", "Write * to multiply.")
        elif (function := self.built_in(call)) is not None:
            self._check_built_in(owner, call, function)
        elif not call.at.quoted and name in self.functions:
            self._check_defined(owner, call)
        elif not call.at.quoted and name in RESERVED:
            self._report(owner, call.at, f"{name} is not a function", "Write * to multiply.")
        elif name in self.definitions or name in self.around.nodes:
            self._report(owner, call.at, f"{name} is a node, not a table", "Write * to multiply.")
        elif name in self.inputs:
            self._report(owner, call.at, f"{name} is an input, not a table", "Write * to multiply.")
        elif outputs := self._outputs_beside(call):
            remedy = nearest(name, outputs) or f"Call one of its outputs: {', '.join(outputs[:8])}."
            self._report(owner, call.at, f"{name} is not an output of a function", remedy)
        elif self._is_table(owner, call):
            self._called.setdefault(name, call.at)
            self._check_axes(owner, name, count, call.at)

    def _outputs_beside(self, call: Call) -> list[str]:
        """Return the outputs of the function that an unknown name such as `f` or `f.x` means, if there is `f.y`."""
        name = call.name
        if call.at.quoted or name in self.declared or name in (self.around.parameters or ()):
            return []
        prefixes = (f"{name}.", f"{name.partition('.')[0]}.")
        return [known for known in self.around.functions if known.startswith(prefixes)]

    def _check_built_in(self, owner: str, call: Call, function: BuiltIn) -> None:
        name, count = call.name, len(call.args)
        declared = self.declared.get(name)
        # a declaration without quotes says that the text means the table by this name
        if name in FUNCTIONS and declared is not None and declared.kind in _TABLE_KINDS and not declared.at.quoted:
            message = f"{name} is the built-in function here, and a {declared.kind} in {self._location(declared.at)}"
            remedy = f"Write %{name}%(...) for the {declared.kind}; quote its declaration to use both."
            self._report(owner, call.at, message, remedy)
            return
        if function.fewest <= count <= function.most:
            return
        few, many = function.fewest, function.most
        wanted = f"{few}" if few == many else f"at least {few}" if many > 99 else f"{few} to {many}"
        arguments = "argument" if wanted == "1" else "arguments"
        signature = function.signature.replace(function.name, call.name, 1)
        self._report(owner, call.at, f"{call.name} takes {wanted} {arguments}, got {count}", f"Write {signature}.")

    def _check_defined(self, owner: str, call: Call) -> None:
        arguments = self.functions[call.name].arguments
        if len(arguments) != len(call.args):
            signature = f"{call.name}({', '.join(argument.name for argument in arguments)})"
            message = f"{call.name} takes {len(arguments)} argument{'s' * (len(arguments) != 1)}, got {len(call.args)}"
            self._report(owner, call.at, message, f"Write {signature}.")

    def _is_table(self, owner: str, call: Call) -> bool:
        name, known = call.name, self.around.parameters
        if not call.args:
            remedy = f"Write {call.at.text}(x), or {call.at.text}."
            self._report(owner, call.at, f"{name} is called without coordinates", remedy)
            return False
        if known is None or name in known or name in self.declared:
            return True
        defines = self.around.table_remedy.format(kind=_KINDS.get(len(call.args), "Cube"), name=name)
        message = f"{self.around.owner} has no parameter {name}" if known or defines else f"unknown function {name}"
        guess = nearest(name, [*known, *self.declared, *FUNCTIONS, *self.functions, *self.around.functions])
        self._report(owner, call.at, message, f"{guess} {defines}".strip())
        return False

    def _check_axes(self, owner: str, name: str, count: int, at: Token) -> None:
        before = self.uses.setdefault(name, at)
        kind = self.declared[name].kind if name in self.declared else ""
        if count > 4 and kind != "rbf" and name not in self.around.axes:
            remedy = f"If it is an expansion in radial basis functions, declare it: rbf {at.text}."
            self._report(owner, at, f"{name} has {count} coordinates; tables have at most 4", remedy)
        elif kind in _AXES and count not in _AXES[kind]:
            message = f"{name} is declared as a {kind} but has {_coordinates(count)} here"
            self._report(owner, at, message, f"Write {_example(name, _AXES[kind][0])}.")
        # without a declaration or a table, the first use decides
        elif self.axes.setdefault(name, count) != count:
            first = self.axes[name]
            where = f" in {self._location(before)}" if before is not at else f" of {self.around.owner}"
            table = _TABLES.get(first, "an expansion")
            message = f"{name} is {table} with {_coordinates(first)}{where} but has {count or 'none'} here"
            self._report(owner, at, message, f"Write {_example(name, first)}.")

    def _check_outputs(self) -> None:
        for name, output in self.outputs.items():
            definition = self.definitions.get(name)
            if definition is None:
                remedy = nearest(name, [n for n, d in self.definitions.items() if not d.auxiliary])
                self.source.report(output.at, f"output {name} is not a defined node", remedy)
            elif definition.auxiliary:
                remedy = "Give the node a name without the underscore."
                self.source.report(output.at, f"output {name} is an auxiliary node", remedy)


def _example(name: str, axes: int) -> str:
    return f"{name}({', '.join('xyzw'[:axes])})" if axes else name


def _coordinates(count: int) -> str:
    return f"{count or 'no'} coordinate{'s' * (count != 1)}"
