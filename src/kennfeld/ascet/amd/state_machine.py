"""State machines of `.specification.amd` files in the syntax tree of ESDL; their conditions and actions are methods."""

from collections.abc import Iterator

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.components import whole
from kennfeld.base.xml_document import XmlElement

MACHINE = "statemachine"
_LAST = 1_000_000
_KNOWN = ("State", "Transition", "Comment")


def state_machine(specification: XmlElement) -> e.StateMachine | e.Unsupported:
    """Return the state machine of a `StateMachineSpecification`, or why it is not supported.

    Transitions are tested in the order of their priorities, 1 first.
    """
    drawn = [
        item for part in specification.all("DiagramElements") for each in part.all("DiagramElement")
        for item in each.children
    ]  # fmt: skip
    place = e.TextPosition(specification.line, 0)
    states = [item for item in drawn if item.tag == "State"]
    strange = next((item for item in drawn if item.tag not in _KNOWN), None)
    nested = next((item for state in states for item in state.children if "Element" in item.tag), None)
    if strange is not None or nested is not None:
        item = strange or nested
        assert item is not None
        part = f"the element {item.tag}" if nested is None else "states within states"
        return e.Unsupported(f"{part} of a state machine is not supported", place=e.TextPosition(item.line, 0))
    owners = {
        port.get("graphicOID"): state.get("name")
        for state in states for part in state.all("Interfaces") for port in part.all("Connector")
    }  # fmt: skip
    # those without a priority last, in the order of the file
    transitions = sorted(
        (item for item in drawn if item.tag == "Transition"), key=lambda item: whole(item.get("priority")) or _LAST
    )
    unknown = next((item for item in transitions if not {*_ends(item)} <= owners.keys()), None)
    if unknown is not None:
        message = "a transition that does not join two states is not supported"
        return e.Unsupported(message, place=e.TextPosition(unknown.line, 0))
    return e.StateMachine(
        MACHINE,
        "",
        tuple(_state(state, [item for item in transitions if owners[_ends(item)[0]] == state.get("name")], owners)
              for state in states),
        next((state.get("name") for state in states if state.is_true("startState")), ""),
        place=place,
    )  # fmt: skip


def _ends(transition: XmlElement) -> tuple[str, str]:
    ends = (transition.first("Start"), transition.first("End"))
    first, last = ("" if end is None else end.get("graphicOID") for end in ends)
    return first, last


def _state(state: XmlElement, transitions: list[XmlElement], owners: dict[str, str]) -> e.State:
    actions = state.first("Actions")
    return e.State(
        state.get("name"),
        _calls(actions, "EntryAction"),
        _calls(actions, "StaticAction"),
        _calls(actions, "ExitAction"),
        tuple(_transition(item, owners[_ends(item)[1]]) for item in transitions),
        keeps_history=state.is_true("history"),
        place=e.TextPosition(state.line, 0),
    )


def _transition(transition: XmlElement, target: str) -> e.Transition:
    place = e.TextPosition(transition.line, 0)
    actions = transition.first("Actions")
    condition: e.Expression = e.Truth(True, place=place)
    written = None if actions is None else actions.first("Condition")
    if written is not None:
        calls = list(_method_calls(written))
        message = "a condition of a transition that is not a method is not supported"
        condition = calls[0] if len(calls) == 1 else e.Unsupported(message, place=place)
    return e.Transition(condition, target, _calls(actions, "Action"), transition.get("triggerName"), place=place)


def _calls(actions: XmlElement | None, tag: str) -> e.Statements:
    """Return the calls of the actions of a kind."""
    parts = [] if actions is None else list(actions.all(tag))
    return tuple(e.Evaluate(call, place=call.place) for part in parts for call in _method_calls(part))


def _method_calls(part: XmlElement) -> Iterator[e.Expression]:
    for item in part.children:
        place = e.TextPosition(item.line, 0)
        if item.tag == "MethodAction":
            yield e.Call(e.Name(item.get("methodName"), place=place), (), place=place)
        else:
            yield e.Unsupported(f"the action {item.tag} of a state machine is not supported", place=place)
