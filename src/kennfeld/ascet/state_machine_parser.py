"""Parser of what stands before declarations, and of state machines."""

from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.statement_parser import EsdlStatementParser
from kennfeld.base.lazy_dataclass import dataclass

_MODIFIERS: Final = frozenset(
    {"public", "private", "protected", "static", "singleton", "stateless", "extern", "virtual", "final", "volatile"}
    | {"nonvolatile", "abstract", "native", "exported", "imported", "local", "inline", "set", "get", "reference"}
)


@dataclass(frozen=True)
class DeclarationHead:
    """Annotations, modifiers and the documentation comment before a declaration."""

    annotations: tuple[e.Annotation, ...]
    modifiers: frozenset[str]
    description: str


class StateMachineParser(EsdlStatementParser):
    """Parser of annotations, modifiers and state machines."""

    def head(self) -> DeclarationHead:
        """Read annotations and modifiers."""
        annotations: list[e.Annotation] = []
        modifiers: list[str] = []
        description = self.token.description
        while True:
            if self.is_at("@"):
                annotations.append(self._annotation())
            elif self.token.kind == "name" and self.token.text in _MODIFIERS and self._is_modifier():
                modifiers.append(self.take().text)
            else:
                return DeclarationHead(tuple(annotations), frozenset(modifiers), self.token.description or description)

    def _is_modifier(self) -> bool:
        """Return True if the next word is a modifier and not the name or type of an element."""
        return self.ahead(1).kind == "name" or self.ahead(1).text in ("@", "^")

    def _annotation(self) -> e.Annotation:
        place = self.expect("@").place
        name = self.qualified_name()
        arguments = self.listed(")", self._annotation_argument) if self.accept("(") else ()
        return e.Annotation(name, arguments, place=place)

    def _annotation_argument(self) -> e.Expression:
        """Read `value` or `key = value`."""
        if self.ahead(1).text == "=":
            self.at += 2
        return self.expression()

    def state_machine(self, place: e.TextPosition) -> e.StateMachine:
        """Read a state machine."""
        self.expect("statemachine")
        name, trigger, labels = self.name(), "", ""
        while self.is_at("default", "using"):
            if self.accept("default"):
                self.expect("trigger")
                trigger = self.name()
            else:
                self.at += 1
                labels = self.qualified_name()
        self.expect("{")
        start, states = "", list[e.State]()
        while not self.accept("}"):
            if self.accept("start"):
                start = self.name()
                self.expect(";")
            else:
                states.append(self.nested(self._state))
        return e.StateMachine(name, labels, tuple(states), start, trigger, place=place)

    def _state(self) -> e.State:
        self.head()
        place = self.token.place
        if not self.is_at("state", "junction"):
            raise self.fault(f"expected a state, got {self._shown()}")
        is_junction = self.take().text == "junction"
        name = self.name()
        actions: dict[str, e.Statements] = {}
        transitions: list[e.Transition] = []
        states: list[e.State] = []
        start, history = "", False
        self.expect("{")
        while not self.accept("}"):
            if self.is_at("entry", "static", "exit") and self.ahead(1).text == "{":
                word = self.take().text
                actions[word] = self.block()
            elif self.is_at("transition"):
                transitions.append(self._transition())
            elif self.accept("start"):
                start = self.name()
                self.expect(";")
            elif self.accept("history"):
                history = True
                self.accept(";")
            else:
                states.append(self.nested(self._state))
        return e.State(
            name,
            actions.get("entry", ()),
            actions.get("static", ()),
            actions.get("exit", ()),
            tuple(transitions),
            tuple(states),
            start,
            is_junction,
            history,
            place=place,
        )

    def _transition(self) -> e.Transition:
        place = self.expect("transition").place
        trigger = ""
        if self.token.kind == "name" and self.ahead(1).text == ":":
            trigger = self.name()
            self.expect(":")
        elif self.accept("trigger"):
            trigger = self.name()
        condition: e.Expression = e.Truth(True, place=place) if self.is_at("to") else self.expression()
        self.expect("to")
        target = self.name()
        action = self.block() if self.is_at("{") else ()
        self.accept(";")
        return e.Transition(condition, target, action, trigger, place=place)
