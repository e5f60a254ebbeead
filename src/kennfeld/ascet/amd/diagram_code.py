"""Statements of the methods of a block diagram, in the syntax tree of ESDL.

A method runs its steps by their sequence numbers: a step assigns the value at its input, calls a method, or runs the
steps below a control block. The value at an input follows from its connection backwards, anew for each step.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.components import TABLES, AscetComponent, MethodSignature
from kennfeld.ascet.amd.diagram import BlockDiagram, BlockPort, SequenceStep, interface_ports
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement

RESULT: Final = "%result"  # the variable of the result of a method; no element has this name
_MAX_DEPTH: Final = 120  # blocks behind each other
_MAX_SIZE: Final = 20_000  # blocks of an expression, each as often as it is used
_CHAINS: Final = {"+": "+", "*": "*", "&": "&&", "|": "||"}
_PAIRS: Final = {
    "-": "-", "/": "/", "=": "==", "!=": "!=", "<": "<", "<=": "<=", ">": ">", ">=": ">=", "%": "%", "mod": "%",
}  # fmt: skip
_FUNCTIONS: Final = {"max": "max", "min": "min", "abs": "abs", "bet": "between"}
_UNARY: Final = {"not": "!", "neg": "-"}
_HEXADECIMAL: Final = re.compile(r"0[xX][0-9a-fA-F]{1,13}")
_REMEDY: Final = "Draw it with other blocks, or write the method in ESDL."


@dataclass(frozen=True)
class DiagramReferences:
    """References of a diagram: signatures of the methods of other components, and labels of enumerations."""

    signature: Callable[[str, str], MethodSignature | None]
    label: Callable[[str], e.Expression | None]


@dataclass(eq=False)
class DiagramCode:
    """Statements of the methods of a diagram.

    Attributes:
        searched: tables whose `search` is called, with the variables that hold what was searched.
    """

    component: AscetComponent
    diagram: BlockDiagram
    references: DiagramReferences
    searched: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._elements = {element.name: element for element in self.component.elements}
        self._known: dict[int, tuple[e.Expression, int]] = {}
        self._open: list[int] = []
        self._arguments: frozenset[str] = frozenset()

    def body(self, method: MethodSignature) -> e.Statements:
        """Return the statements of a method; parts that are not supported are `Unsupported` expressions in them."""
        # the value of a block may depend on the method: its arguments hide elements of the same names
        self._known.clear()
        self._arguments = frozenset(argument.name for argument in method.arguments)
        return self._sequence(self.diagram.steps.get(method.name, ()))

    def _sequence(self, steps: Sequence[SequenceStep]) -> e.Statements:
        if len(self._open) > _MAX_DEPTH:
            return ()
        return tuple(self._step(step) for step in steps)

    def _step(self, step: SequenceStep) -> e.Statement:
        place = _place(step.block)
        match step.block.tag, step.port.tag:
            case "SimpleElement", "SelectorPort":
                target = self._element(step.block)
                return e.Assign(target, self._input(step.port), place=place)
            case "Control", _:
                return self._control(step, place)
            case "ComplexElement", "MethodPort":
                return self._called(step, place)
            case "ComplexElement", "MemberSetPort":
                target = e.Field(self._element(step.block), step.port.get("elementName"), place=place)
                return e.Assign(target, self._input(step.port), place=place)
        return _unsupported_statement(f"a step of a {step.block.tag} block", place)

    def _control(self, step: SequenceStep, place: e.TextPosition) -> e.Statement:
        kind = step.block.get("type")
        if kind == "Break":
            return e.Return(place=place)
        if kind not in ("IfThen", "IfThenElse"):
            return _unsupported_statement(f"the control block {kind}", place)
        identifier = step.block.get("graphicOID")
        self._open.append(id(step.block))
        bodies = [self._sequence(self.diagram.branches.get((identifier, at), ())) for at in range(2)]
        self._open.pop()
        return e.If(self._input(step.port), *bodies, place=place)

    def _called(self, step: SequenceStep, place: e.TextPosition) -> e.Statement:
        """Return the call of a method without a result."""
        name, method = step.block.get("elementName"), step.port.get("methodName")
        inputs = {BlockPort(step.block, item).name: item for item in step.port.all("SelectorPort")}
        kind = self._model_type(step.block)
        if kind in TABLES and method == "search":
            return self._search(name, [inputs[axis] for axis in ("x", "y") if axis in inputs], place)
        if kind == "array" and method == "setAt" and len(inputs) == 2:
            return self._set_element(step.block, inputs, place)
        if (
            kind in TABLES
            or kind == "array"
            or (step.port.is_true("defaultMethod") and "methodOID" not in (step.port.attributes))
        ):
            return _unsupported_statement(f"the method {method} of {name}", place)
        return e.Evaluate(self._call(step.block, method, list(step.port.all("SelectorPort"))), place=place)

    def _set_element(self, block: XmlElement, inputs: dict[str, XmlElement], place: e.TextPosition) -> e.Statement:
        """Return the assignment to an element of an array."""
        at = next((port for name, port in inputs.items() if name.lower().startswith(("i", "x"))), None)
        value = next((port for port in inputs.values() if port is not at), None)
        if at is None or value is None:
            return _unsupported_statement(f"the method setAt of {block.get('elementName')}", place)
        target = e.Index(self._element(block), self._input(at), place=place)
        return e.Assign(target, self._input(value), place=place)

    def _search(self, name: str, inputs: Sequence[XmlElement], place: e.TextPosition) -> e.Statement:
        """Return the statements that keep what is searched, for the interpolation that follows."""
        names = tuple(f"{name}.search.{axis}" for axis in ("x", "y")[: len(inputs)])
        self.searched[name] = names
        pairs = zip(names, inputs, strict=True)
        return e.Block(tuple(e.Assign(e.Name(own), self._input(port), place=place) for own, port in pairs), place=place)

    # values

    def _input(self, port: XmlElement) -> e.Expression:
        """Return the value at an input."""
        sources = self.diagram.sources(port)
        place = _place(port)
        if len(sources) != 1:
            message = "an input is not connected" if not sources else f"an input is connected to {len(sources)} outputs"
            return e.Unsupported(message, "Connect it to one output.", place=place)
        return self._output(sources[0])[0]

    def _output(self, port: BlockPort) -> tuple[e.Expression, int]:
        """Return the value of an output, and its size in blocks."""
        key = id(port.element)
        if key not in self._known:
            place = _place(port.block)
            if key in self._open:
                return e.Unsupported("the blocks form a loop without a variable", _REMEDY, place=place), 1
            if len(self._open) > _MAX_DEPTH:
                return e.Unsupported(f"more than {_MAX_DEPTH} blocks behind each other", _REMEDY, place=place), 1
            self._open.append(key)
            result = self._value(port, place)
            self._open.pop()
            size = 1 + sum(
                self._known[id(out.element)][1] for out in self._behind(port) if id(out.element) in self._known
            )
            if size > _MAX_SIZE:
                message = f"an expression of more than {_MAX_SIZE} blocks"
                result, size = e.Unsupported(message, "Store parts of it in variables.", place=place), 1
            self._known[key] = result, size
        return self._known[key]

    def _behind(self, port: BlockPort) -> list[BlockPort]:
        inputs = [item for item in port.element.walk() if item.tag in ("SelectorPort", "InputPort")]
        if port.block.tag == "ImplementationCast":
            inputs = interface_ports(port.block)
        return [out for item in inputs for out in self.diagram.sources(item)]

    def _value(self, port: BlockPort, place: e.TextPosition) -> e.Expression:
        block = port.block
        match block.tag:
            case "SimpleElement":
                return self._element(block)
            case "Literal":
                return self._literal(block.get("value"), place)
            case "Operator":
                return self._operator(port, place)
            case "ImplementationCast":
                return self._input(next((item for item in interface_ports(block) if item.tag == "SelectorPort"), block))
            case "ComplexElement" if port.element.tag == "MemberGetPort":
                return e.Field(self._element(block), port.element.get("elementName"), place=place)
            case "ComplexElement":
                return self._method_value(port, place)
        return _unsupported(f"the output of a {block.tag} block as a value", place)

    def _element(self, block: XmlElement) -> e.Expression:
        """Return the element, argument or result that a block stands for."""
        name, place = block.get("elementName"), _place(block)
        if block.get("type") == "Return":
            return e.Name(RESULT, place=place)
        if block.get("type") != "Argument" and name in self._arguments:
            # the argument of this name hides the element
            return e.Field(e.Name("this", place=place), name, place=place)
        return e.Name(name, place=place)

    def _model_type(self, block: XmlElement) -> str:
        element = self._elements.get(block.get("elementName"))
        types = {"CharTable1D": "oned", "CharTable2D": "twod", "Array": "array", "Matrix": "matrix"}
        return element.model_type if element is not None else types.get(block.get("type"), "complex")

    def _literal(self, text: str, place: e.TextPosition) -> e.Expression:
        if text in ("true", "false"):
            return e.Truth(text == "true", text, place=place)
        number = _number(text)
        if number is not None:
            is_real = not (text.lstrip("+-").isdecimal() or _HEXADECIMAL.fullmatch(text))
            return e.Number(number, is_real, text=text, place=place)
        label = self.references.label(text)
        return label if label is not None else _unsupported(f"the literal {text[:40]!r}", place)

    def _operator(self, port: BlockPort, place: e.TextPosition) -> e.Expression:
        kind = port.block.get("type")
        inputs = sorted(
            (BlockPort(port.block, item) for item in port.element.children), key=lambda item: item.index or 0
        )
        if kind == "MUX":
            return self._switch(inputs, place)
        if kind == "Case":
            return self._case(inputs, place)
        values = [self._input(item.element) for item in inputs]
        if len(values) == 1 and (kind in _UNARY or kind == "-"):
            return e.Unary(_UNARY.get(kind, "-"), values[0], place=place)
        if len(values) > 1 and kind in _CHAINS:
            return _chain(_CHAINS[kind], values, place)
        if len(values) == 2 and kind in _PAIRS:
            return e.Binary(_PAIRS[kind], *values, place=place)
        if kind == "bet" and len(values) == 3:
            return e.Between(*values, place=place)
        # abs takes one value, the others two or more
        if kind in _FUNCTIONS and len(values) > (kind != "abs"):
            return e.Call(e.Name(_FUNCTIONS[kind], place=place), tuple(values), place=place)
        return _unsupported(f"the operator {kind} with {len(values)} inputs", place)

    def _switch(self, inputs: Sequence[BlockPort], place: e.TextPosition) -> e.Expression:
        """Return the value of a multiplexer: that of the input of the first condition which is true."""
        conditions = [item for item in inputs if item.element.tag == "SelectorPort"]
        values = {item.name: item for item in inputs if item.element.tag == "InputPort"}
        if len(values) != len(conditions) + 1 or "default" not in values:
            return _unsupported(f"a multiplexer with the inputs {', '.join(values)}", place)
        result = self._input(values["default"].element)
        # from the last condition to the first, as each is the alternative of the one before
        for at in range(len(conditions), 0, -1):
            chosen = values.get(str(at))
            if chosen is None:
                return _unsupported(f"a multiplexer without the input {at}", place)
            condition = self._input(conditions[at - 1].element)
            result = e.Conditional(condition, self._input(chosen.element), result, place=place)
        return result

    def _case(self, inputs: Sequence[BlockPort], place: e.TextPosition) -> e.Expression:
        """Return the value of a case operator: that of the input whose name is the number at the first input."""
        if not inputs or inputs[0].element.tag != "SelectorPort":
            return _unsupported("a case operator without a selector", place)
        subject, *others = inputs
        otherwise: e.Expression | None = None
        cases = []
        for item in others:
            value = self._input(item.element)
            if item.name == "default":
                otherwise = value
                continue
            key = self._literal(item.name, place)
            cases.append(((key,), value))
        return e.Choice(self._input(subject.element), tuple(cases), otherwise, place=place)

    def _method_value(self, port: BlockPort, place: e.TextPosition) -> e.Expression:
        """Return the result of a method."""
        name, method = port.block.get("elementName"), port.element.get("methodName")
        arguments = {BlockPort(port.block, item).name: item for item in port.element.all("SelectorPort")}
        kind = self._model_type(port.block)
        of = self._element(port.block)
        if kind in TABLES and method == "getAt":
            values = [self._input(arguments[axis]) for axis in ("x", "y") if axis in arguments]
            return e.Call(e.Field(of, "getAt", place=place), tuple(values), place=place)
        if kind in TABLES and method == "interpolate":
            # interpolate() has no inputs: it takes what was searched
            names = tuple(f"{name}.search.{axis}" for axis in ("x", "y")[: TABLES.index(kind) + 1])
            self.searched[name] = names
            return e.Call(e.Field(of, "getAt", place=place), tuple(map(e.Name, names)), place=place)
        if kind == "array" and method == "getAt" and len(arguments) == 1:
            return e.Index(of, self._input(*arguments.values()), place=place)
        if kind == "array" and method == "get" and not arguments:
            return of
        if kind in (*TABLES, "array", "matrix") or port.element.is_true("defaultPort"):
            return _unsupported(f"the method {method} of {name}", place)
        return self._call(port.block, method, list(arguments.values()))

    def _call(self, block: XmlElement, method: str, inputs: Sequence[XmlElement]) -> e.Expression:
        """Return the call of a method of an instance, with its arguments in the order of its signature."""
        name, place = block.get("elementName"), _place(block)
        element = self._elements.get(name)
        signature = None if element is None else self.references.signature(element.reference, method)
        by_name = {BlockPort(block, item).name: item for item in inputs}
        of = e.Field(self._element(block), method, place=place)
        if signature is None:
            reference = element.reference if element is not None else name
            message = f"the method {method} of {name}, whose class {reference or '?'} is missing or lacks it,"
            return _unsupported(message, place)
        missing = [argument.name for argument in signature.arguments if argument.name not in by_name]
        if missing:
            return _unsupported(f"a call of {name}.{method} without the argument {missing[0]}", place)
        values = tuple(self._input(by_name[argument.name]) for argument in signature.arguments)
        return e.Call(of, values, place=place)


def _place(element: XmlElement) -> e.TextPosition:
    return e.TextPosition(element.line, 0)


def _chain(operator: str, values: Sequence[e.Expression], place: e.TextPosition) -> e.Expression:
    result, *others = values
    for value in others:
        result = e.Binary(operator, result, value, place=place)
    return result


def _number(text: str) -> float | None:
    if _HEXADECIMAL.fullmatch(text):
        return float(int(text, 16))
    try:
        # float() accepts 1_000
        number = float(text.replace("_", "x"))
    except ValueError:
        return None
    return number if abs(number) < float("inf") else None


def _unsupported(subject: str, place: e.TextPosition) -> e.Unsupported:
    return e.Unsupported(f"{subject} is not supported", _REMEDY, place=place)


def _unsupported_statement(subject: str, place: e.TextPosition) -> e.Statement:
    return e.Evaluate(_unsupported(subject, place), place=place)
