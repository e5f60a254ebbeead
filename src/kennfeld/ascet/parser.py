"""Parser of ESDL files: classes, data interfaces, types, units and constants.

After an error the parser continues with the next statement, member or declaration, so that all errors of a file are
reported at once. Representations say how numbers are stored in a control unit; they are skipped.
"""

from collections.abc import Callable, Iterable
from dataclasses import field
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.expression_parser import EsdlSyntaxError
from kennfeld.ascet.lexer import MAX_CHARACTERS, tokens_of
from kennfeld.ascet.state_machine_parser import DeclarationHead, StateMachineParser
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass

_MAX_ERRORS: Final = 40
_KINDS: Final = ("characteristic", "const", "sysconst")
_DECLARES: Final = frozenset(
    {"type", "unit", "class", "data", "formula", "representation", "qualifier", "segment", "import", *_KINDS}
)
_SKIPPED: Final = ("formula", "representation", "qualifier", "segment", "dataset", "variant")


@dataclass(frozen=True)
class ParsedFile:
    """The tree of a file and its syntax errors; with errors, the tree lacks the parts that have them."""

    file: e.EsdlFile
    findings: tuple[Finding, ...] = ()


def parse_esdl(text: str, name: str = "text") -> e.EsdlFile:
    """Parse an ESDL file.

    Args:
        text: the text of the file.
        name: name of the file in messages.

    Raises:
        InputError: with all syntax errors.

    >>> parse_esdl("package a; class C { characteristic real K = 2.0; }").declarations[0].elements[0].value.value
    2.0
    """
    result = scan_esdl(text, name)
    if result.findings:
        raise InputError(result.findings)
    return result.file


def scan_esdl(text: str, name: str = "text") -> ParsedFile:
    """Parse an ESDL file as far as it can be read, and return the syntax errors with it."""
    if len(text) > MAX_CHARACTERS:
        message = f"the file has {len(text)} characters; the maximum is {MAX_CHARACTERS}"
        return ParsedFile(e.EsdlFile(name), (Finding(Location(name), message, "Split the file."),))
    parser = _FileParser(text, name)
    try:
        file = parser.file()
    except _TooManyErrorsError:
        file = e.EsdlFile(name)
    return ParsedFile(file, tuple(parser.findings))


class _TooManyErrorsError(Exception):
    pass


@dataclass
class _Members:
    elements: list[e.Element] = field(default_factory=list)
    methods: list[e.Method] = field(default_factory=list)
    machines: list[e.StateMachine] = field(default_factory=list)
    initializers: list[e.Initializer] = field(default_factory=list)


class _FileParser(StateMachineParser):
    def __init__(self, text: str, name: str) -> None:
        super().__init__(tokens_of(text))
        self.file_name, self.findings = name, list[Finding]()

    # errors

    def _recover(self, read: Callable[[], None], starts: Iterable[str] = ()) -> None:
        """Call `read`; after an error in it, skip to the end of the statement, member or declaration."""
        begin = self.at
        try:
            read()
        except EsdlSyntaxError as error:
            self._report(error)
            self._skip(starts)
            # an error at a token that nothing skips would be found again and again
            if self.at == begin and not self.is_at("}"):
                self.take()

    def _report(self, error: EsdlSyntaxError) -> None:
        place = error.token.place
        location = Location(self.file_name, place.line, column=place.column)
        self.findings.append(Finding(location, error.message, error.remedy))
        if len(self.findings) >= _MAX_ERRORS:
            raise _TooManyErrorsError from None

    def _skip(self, starts: Iterable[str] = ()) -> None:
        """Skip to behind the next `;` or block, or to a `}` or one of the words in `starts`."""
        depth, words = 0, frozenset(starts)
        while self.token.kind != "end":
            if depth == 0 and (self.is_at("}") or (self.token.kind == "name" and self.token.text in words)):
                return
            text = self.take().text
            depth += (text == "{") - (text == "}")
            if depth == 0 and text in (";", "}"):
                return

    def _recovering_statement(self) -> e.Statements:
        result: list[e.Statement] = []
        self._recover(lambda: result.extend(self.statement()))
        return tuple(result)

    # files

    def file(self) -> e.EsdlFile:
        """Read the file."""
        self.package, self.imports = "", list[str]()
        self.declarations: list[e.Declaration] = []
        while self.token.kind != "end":
            self._recover(self._declaration, _DECLARES)
            if self.is_at("}"):
                self._recover(self._unexpected_brace)
        return e.EsdlFile(self.file_name, self.package, tuple(self.imports), tuple(self.declarations))

    def _unexpected_brace(self) -> None:
        error = self.fault("unexpected '}'")
        self.take()
        self._report(error)

    def _declaration(self) -> None:
        if self.accept(";"):
            return
        head = self.head()
        place = self.token.place
        match self.token.text:
            case "package":
                self.at += 1
                self.package = self.qualified_name()
                self.accept(";")
            case "import":
                self.at += 1
                self.imports.append(self.qualified_name())
                self.expect(";")
            case "type":
                self.declarations.append(self._type_declaration(place))
            case "unit":
                self.declarations.append(self._unit_declaration(place))
            case "data" | "interface":
                self.declarations.append(self._interface(place))
            case "class":
                self.declarations.append(self._class(head, place))
            case word if word in _SKIPPED:
                self._skip()
            case word if word in _KINDS:
                self.declarations += [e.Constant(element, place=place) for element in self._elements(head)]
            case _:
                raise self.fault(f"expected a declaration, got {self._shown()}")

    # types and units

    def _type_declaration(self, place: e.TextPosition) -> e.TypeDeclaration:
        self.expect("type")
        name = self.name()
        self.expect("is")
        result = e.TypeDeclaration(name, self.type(), place=place)
        self.accept(";")
        return result

    def _unit_declaration(self, place: e.TextPosition) -> e.UnitDeclaration:
        self.expect("unit")
        name = self.name()
        expression = self.expression() if self.accept("=") else None
        self.accept(";")
        return e.UnitDeclaration(name, expression, place=place)

    def type(self) -> e.TypeExpression:
        """Read the definition of a type."""
        return self.nested(self._type)

    def _type(self) -> e.TypeExpression:
        place = self.token.place
        if self.is_at("native") and self.ahead(1).kind == "name":
            self.at += 1
        match self.token.text:
            case "enum":
                return self._enum(place)
            case "struct":
                return self._struct(place)
            case "array" | "matrix":
                self.at += 1
                sizes = self.sizes()
                self.expect("of")
                return e.ArrayType(sizes, self.type(), place=place)
            case "axis" | "distribution":
                self.at += 1
                return e.AxisType(self.type(), place=place)
            case "fixed" | "group" | "table":
                form = self.take().text if not self.is_at("table") else ""
                return self._table(form, place)
            case "dataspace":
                self._skip_to_semicolon()
                return e.UnsupportedType("dataspace", place=place)
        return self._scalar(place)

    def _skip_to_semicolon(self) -> None:
        while not self.is_at(";", "}") and self.token.kind != "end":
            self.take()

    def _table(self, form: str, place: e.TextPosition) -> e.TableType:
        self.expect("table")
        axes = self.series(self.type)
        self.expect("->")
        return e.TableType(axes, self.type(), form, place=place)

    def _scalar(self, place: e.TextPosition) -> e.TypeExpression:
        # the unit stands before or behind the range
        base, unit = self.qualified_name(), ""
        if self.is_at("["):
            unit = self._unit()
        has_range = self.is_at("..", "-", "+") or self.token.kind == "number" or self._names_range()
        limits = self.range() if has_range else None
        if limits is not None and not isinstance(limits, e.Range):
            raise self.fault("expected '..' in the range of a type")
        delta = self.expression() if self.accept("delta") else None
        using = self.qualified_name() if self.accept("using") else ""
        if self.is_at("["):
            unit = self._unit()
        if limits is None and delta is None and not using and not unit:
            return e.TypeName(base, place=place)
        return e.ScalarType(base, limits, delta, using, unit, place=place)

    def _names_range(self) -> bool:
        """Return True if a range starts with a name, as in `integer LOW .. HIGH`."""
        at = 0
        if self.token.kind != "name" or self.is_at("delta", "using", "is"):
            return False
        while self.ahead(at + 1).text == "." and self.ahead(at + 2).kind == "name":
            at += 2
        return self.ahead(at + 1).text == ".."

    def _enum(self, place: e.TextPosition) -> e.EnumType:
        self.expect("enum")
        self.expect("{")
        return e.EnumType(self.listed("}", self._label), place=place)

    def _label(self) -> tuple[str, e.Expression | None]:
        self.head()
        name = self.name()
        return name, self.expression() if self.accept("=") else None

    def _struct(self, place: e.TextPosition) -> e.StructType:
        self.expect("struct")
        members = self._members()
        return e.StructType(tuple(members.elements), place=place)

    # classes and interfaces

    def _interface(self, place: e.TextPosition) -> e.Interface:
        self.accept("data")
        self.expect("interface")
        name = self.name()
        if self.accept("using"):
            self.qualified_name()
        return e.Interface(name, tuple(self._members().elements), place=place)

    def _class(self, head: DeclarationHead, place: e.TextPosition) -> e.ClassDeclaration:
        self.expect("class")
        name = self.name()
        clauses: dict[str, list[str]] = {"reads": [], "writes": [], "using": [], "extends": [], "implements": []}
        while self.is_at(*clauses):
            clauses[self.take().text] += self.series(self.qualified_name)
        members = self._members()
        return e.ClassDeclaration(
            name,
            tuple(members.elements),
            tuple(members.methods),
            tuple(members.machines),
            tuple(members.initializers),
            tuple(clauses["reads"]),
            tuple(clauses["writes"]),
            head.modifiers,
            head.annotations,
            next(iter(clauses["using"]), ""),
            place=place,
        )

    def _members(self) -> _Members:
        """Read `{ members }`."""
        self.expect("{")
        members = _Members()
        while not self.accept("}"):
            if self.token.kind == "end":
                raise self.fault("} is missing at the end of a class, interface or struct")
            self._recover(lambda: self._member(members))
        return members

    def _member(self, members: _Members) -> None:
        if self.accept(";"):
            return
        head = self.head()
        place = self.token.place
        if self.is_at("representation", "formula", "dataset"):
            self._skip()
        elif self.is_at("initializer") and self.ahead(2).text == "(":
            members.initializers.append(self._initializer(place))
        elif self.is_at("statemachine"):
            members.machines.append(self.state_machine(place))
        elif self._is_method():
            members.methods.append(self._method(head, place))
        else:
            members.elements += self._elements(head)

    def _is_method(self) -> bool:
        # type and name with a bracket behind; the tokens are read again
        at = self.at
        try:
            self.qualified_name()
            while self.is_at("["):
                self.sizes()
            self.name()
            return self.is_at("(")
        except EsdlSyntaxError:
            return False
        finally:
            self.at = at

    def _initializer(self, place: e.TextPosition) -> e.Initializer:
        self.expect("initializer")
        name = self.name()
        self._arguments()
        return e.Initializer(name, self.block(), place=place)

    def _elements(self, head: DeclarationHead) -> list[e.Element]:
        """Read the declaration of one or several elements of a type."""
        kind = self.take().text if self.is_at(*_KINDS) else ""
        # modifiers stand before or behind the kind
        more = self.head() if kind else head
        modifiers = head.modifiers | more.modifiers
        description = head.description or more.description
        type_of_all = e.TypeName(self.qualified_name(), place=self.token.place)
        result: list[e.Element] = []
        while True:
            place, name, sizes = self.token.place, self.name(), self.sizes()
            if self.accept("in"):
                self.range()
            value = self.expression() if self.accept("=") else None
            formula = self._formula() if self.accept("<-") else None
            if self.accept("using"):
                self.qualified_name()
            result.append(
                e.Element(
                    name,
                    type_of_all,
                    kind,
                    sizes,
                    value,
                    formula,
                    modifiers,
                    head.annotations,
                    description,
                    place=place,
                )
            )
            if not self.accept(","):
                break
        self.expect(";")
        return result

    def _formula(self) -> tuple[str, tuple[tuple[str, e.Expression], ...]]:
        """Read `"formula", letter = element, ...`."""
        if self.token.kind != "text":
            raise self.fault('expected the formula of a dependent parameter in "..."')
        text = self.take().text[1:-1]
        letters: list[tuple[str, e.Expression]] = []
        while self.accept(","):
            name = self.name()
            self.expect("=")
            letters.append((name, self.expression()))
        return text, tuple(letters)

    def _method(self, head: DeclarationHead, place: e.TextPosition) -> e.Method:
        result = e.TypeName(self.qualified_name(), place=place)
        self.sizes()
        place = self.token.place
        name = self.name()
        self.expect("(")
        arguments = self.listed(")", self._argument)
        triggers = ""
        while self.is_at("triggers", "using", "reads", "writes"):
            word, names = self.take().text, self.series(self.qualified_name)
            triggers = names[0] if word == "triggers" else triggers
        body = None if self.accept(";") else self.block()
        is_void = result.name == "void"
        return e.Method(
            name, None if is_void else result, arguments, body, triggers, head.modifiers, head.annotations,
            place=place,
        )  # fmt: skip

    def _argument(self) -> e.Argument:
        self.head()
        place = self.token.place
        words = ("in", "out", "inout")
        direction = self.take().text if self.is_at(*words) else ""
        type_name = e.TypeName(self.qualified_name(), place=place)
        self.sizes()
        # the direction stands before or behind the type
        if self.is_at(*words) and not direction:
            direction = self.take().text
        at = self.token.place
        name = self.name()
        self.sizes()
        return e.Argument(name, type_name, direction or "in", place=at)
