"""Parser of the statements of ESDL methods."""

from kennfeld.ascet import syntax as e
from kennfeld.ascet.expression_parser import EsdlExpressionParser
from kennfeld.ascet.lexer import Token

_CHANGES = ("+=", "-=", "*=", "/=", "%=", "&=", "|=", "^=", "<<=", ">>=")
_MAX_CHAIN = 100  # of else if


class EsdlStatementParser(EsdlExpressionParser):
    """Parser of statements; `recover` decides how to continue after an error in one of them."""

    def block(self) -> e.Statements:
        """Read `{ statements }`."""
        self.expect("{")
        statements: list[e.Statement] = []
        while not self.accept("}"):
            if self.token.kind == "end":
                raise self.fault("} is missing")
            statements += self._recovering_statement()
        return tuple(statements)

    def _recovering_statement(self) -> e.Statements:
        """Read a statement; after an error in it, none."""
        return self.statement()

    def statement(self) -> e.Statements:
        """Read a statement; an empty one is none."""
        return self.nested(self._statement)

    def _statement(self) -> e.Statements:
        place = self.token.place
        if self.accept(";"):
            return ()
        match self.token.text if self.token.kind in ("name", "operator") else "":
            case "{":
                return (e.Block(self.block(), place=place),)
            case "if":
                return (self._if(),)
            case "while":
                return (self._while(),)
            case "do":
                return (self._do(),)
            case "for":
                return (self._for(),)
            case "switch":
                return (self._switch(),)
            case "return":
                self.at += 1
                value = None if self.is_at(";") else self.expression()
                self.expect(";")
                return (e.Return(value, place=place),)
            case "break" | "continue" if self.ahead(1).text == ";":
                kind = self.take().text
                self.expect(";")
                return (e.Jump(kind, place=place),)
        return self._variables() if self._declares() else (self._assignment(),)

    def body(self) -> e.Statements:
        """Read the statement that a condition or loop controls."""
        return self.block() if self.is_at("{") else self.statement()

    def _if(self) -> e.If:
        conditions: list[tuple[e.TextPosition, e.Expression, e.Statements]] = []
        otherwise: e.Statements = ()
        while True:
            place = self.expect("if").place
            conditions.append((place, self._condition(), self.body()))
            if not self.accept("else"):
                break
            if len(conditions) > _MAX_CHAIN:
                raise self.fault(f"more than {_MAX_CHAIN} branches", "Use switch.")
            if not self.is_at("if"):
                otherwise = self.body()
                break
        # a loop instead of a recursion for each `else if`, whose chain may be longer than the nesting that is allowed
        for place, condition, body in reversed(conditions):
            result = e.If(condition, body, otherwise, place=place)
            otherwise = (result,)
        return result

    def _condition(self) -> e.Expression:
        self.expect("(")
        condition = self.expression()
        self.expect(")")
        return condition

    def _while(self) -> e.While:
        place = self.expect("while").place
        return e.While(self._condition(), self.body(), place=place)

    def _do(self) -> e.While:
        place = self.expect("do").place
        body = self.body()
        self.expect("while")
        condition = self._condition()
        self.accept(";")
        return e.While(condition, body, True, place=place)

    def _for(self) -> e.For:
        place = self.expect("for").place
        self.expect("(")
        if self.ahead(1).kind == "name" and self.ahead(1).text != "in":
            self.at += 1  # the type of the variable
        name = self.name()
        self.expect("in")
        values = self.range()
        self.expect(")")
        return e.For(name, values, self.body(), place=place)

    def _switch(self) -> e.Switch:
        place = self.expect("switch").place
        subject = self._condition()
        self.expect("{")
        cases: list[tuple[tuple[e.Expression, ...], e.Statements]] = []
        otherwise: e.Statements = ()
        while not self.accept("}"):
            keys = self.case_keys()
            body: list[e.Statement] = []
            while not self.is_at("case", "default", "}") and self.token.kind != "end":
                body += self._recovering_statement()
            if keys:
                cases.append((keys, tuple(body)))
            else:
                otherwise = tuple(body)
        return e.Switch(subject, tuple(cases), otherwise, place=place)

    def _declares(self) -> bool:
        """Return True if the next statement declares a variable: a type is followed by a name."""
        if self.is_at("const", "static", "characteristic"):
            return True
        at = 0
        if self.ahead(at).kind != "name":
            return False
        while self.ahead(at + 1).text == "." and self.ahead(at + 2).kind == "name":
            at += 2
        following: Token = self.ahead(at + 1)
        return following.kind == "name" or (following.text == "^" and self.ahead(at + 3).text in ("=", ";", "["))

    def _variables(self) -> e.Statements:
        kind = self.take().text if self.is_at("const", "static", "characteristic") else ""
        kind_of_type = self.type_of_variable()
        result: list[e.Statement] = []
        while True:
            at = self.token.place
            name, sizes = self.name(), self.sizes()
            value = self.expression() if self.accept("=") else None
            element = e.Element(name, kind_of_type, "const" if kind == "const" else "", sizes, value, place=at)
            result.append(e.Declare(element, place=at))
            if not self.accept(","):
                break
        self.expect(";")
        return tuple(result)

    def type_of_variable(self) -> e.TypeExpression:
        """Read the name of the type of a local variable."""
        place = self.token.place
        return e.TypeName(self.qualified_name(), place=place)

    def sizes(self) -> tuple[e.Expression | None, ...]:
        """Read dimensions, `[4][2]`; `[]` is None."""
        result: list[e.Expression | None] = []
        while self.accept("["):
            result.append(None if self.is_at("]") else self.range())
            self.expect("]")
        return tuple(result)

    def _assignment(self) -> e.Statement:
        place = self.token.place
        target = self.expression()
        if self.is_at("=", *_CHANGES):
            operator = self.take().text[:-1]
            value = self.expression()
            self.expect(";")
            return e.Assign(target, value, operator, place=place)
        if self.is_at("++", "--"):
            operator = self.take().text[0]
            self.expect(";")
            return e.Assign(target, e.Number(1.0, False, place=place), operator, place=place)
        if not isinstance(target, e.Call):
            raise self.fault(f"expected '=', got {self._shown()}")
        self.expect(";")
        return e.Evaluate(target, place=place)
