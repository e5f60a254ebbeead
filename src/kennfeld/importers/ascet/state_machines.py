"""State machines as statements of ESDL.

As in generated code, a trigger first tests the transitions of the outermost active state, then those within. A
transition runs the exit actions from the inner to the outer state, its own action, and the entry actions from the outer
to the inner state; states that stay active around it then run their static actions. Without a transition, the static
actions run from the inner to the outer state. The first state is entered without its entry action.

A state that keeps its history is entered with the inner state that was active when it was left last, at first with its
start. The inner state decides on its own inner ones in the same way.
"""

from collections.abc import Iterator, Mapping
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.declarations import FileScope
from kennfeld.importers.ascet.resolved_types import NumberType
from kennfeld.importers.ascet.type_resolution import TypeResolver
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError

STATE: Final = "%state"  # name of the variable of the state within the statements
_TAKEN = "%taken"
_MAX_JUNCTIONS = 20  # passed by one transition
_MAX_PATHS = 2_000  # of all transitions through junctions


@dataclass(frozen=True)
class _StatePath:
    """A state with those around it, the outermost first."""

    states: tuple[e.State, ...]

    @property
    def name(self) -> str:
        return self.states[-1].name


def state_numbers(types: TypeResolver, scope: FileScope, machine: e.StateMachine) -> dict[str, int]:
    """Return the numbers of the states without inner states: those of the enumeration, else counted."""
    names = [path.name for path in _paths(machine.states) if not _inner(path.states[-1])]
    # code may compare a state with a word of this enumeration; without one, any numbers tell states apart
    if machine.labels:
        try:
            kind = types.named(machine.labels, scope)
        except UnsupportedEsdlError:
            kind = None
        if isinstance(kind, NumberType) and set(names) <= dict(kind.labels).keys():
            return {name: dict(kind.labels)[name] for name in names}
    return {name: at for at, name in enumerate(names)}


def start_leaf(machine: e.StateMachine) -> str:
    """Return the state that is active first; empty if the machine has no start."""
    by_name = {path.name: path for path in _paths(machine.states)}
    if machine.start not in by_name:
        return ""
    return _entered(by_name[machine.start]).name


def _paths(states: tuple[e.State, ...], around: tuple[e.State, ...] = ()) -> Iterator[_StatePath]:
    """Yield all states, without junctions."""
    for state in states:
        if not state.is_junction:
            yield _StatePath((*around, state))
            yield from _paths(state.states, (*around, state))


def _junctions(states: tuple[e.State, ...]) -> Iterator[e.State]:
    for state in states:
        if state.is_junction:
            yield state
        yield from _junctions(state.states)


def _inner(state: e.State) -> tuple[e.State, ...]:
    return tuple(inner for inner in state.states if not inner.is_junction)


def _entered(path: _StatePath) -> _StatePath:
    """Return the innermost state that is entered with a state at first."""
    # down to a state without inner states, which alone has a number
    while _inner(path.states[-1]):
        path = _started(path)
    return path


def _started(path: _StatePath) -> _StatePath:
    """Return the inner state that a state starts with."""
    state = path.states[-1]
    following = next((inner for inner in _inner(state) if inner.name == state.start), None)
    if following is None:
        raise UnsupportedEsdlError(f"the state {path.name} has no start", place=state.place)
    return _StatePath((*path.states, following))


def history_name(state: str) -> str:
    """Return the name of the variable within the statements that keeps the inner state a state was left in."""
    return f"%history {state}"


def histories(machine: e.StateMachine) -> dict[str, str]:
    """Return the states that keep their history, with the innermost state that each is entered with at first."""
    paths = [path for path in _paths(machine.states) if path.states[-1].keeps_history and _inner(path.states[-1])]
    return {path.name: _entered(path).name for path in paths}


def machine_statements(machine: e.StateMachine, numbers: Mapping[str, int], trigger: str) -> e.Statements:
    """Return the statements of a trigger of a state machine.

    Args:
        machine: the state machine.
        numbers: numbers of the innermost states by name.
        trigger: name of the method that triggers it.

    Raises:
        UnsupportedEsdlError: a target is unknown.
    """
    return _MachineCode(machine, numbers, trigger).statements()


class _MachineCode:
    def __init__(self, machine: e.StateMachine, numbers: Mapping[str, int], trigger: str) -> None:
        self.machine, self.numbers, self.trigger = machine, numbers, trigger
        self.by_name = {path.name: path for path in _paths(machine.states)}
        self.paths = 0
        self.junctions = {state.name: state for state in _junctions(machine.states)}

    def statements(self) -> e.Statements:
        place = self.machine.place
        leaves = [path for path in self.by_name.values() if path.name in self.numbers]
        cases = tuple(
            ((e.Number(float(self.numbers[leaf.name]), False, place=place),), self._active(leaf)) for leaf in leaves
        )
        taken = e.Element(_TAKEN, e.TypeName("boolean"), place=place)
        return (
            e.Declare(taken, place=place),
            e.Switch(e.Name(STATE, place=place), cases, place=place),
        )

    def _active(self, leaf: _StatePath) -> e.Statements:
        """Return the statements of a trigger while a state is active."""
        transitions = [
            (depth, transition)
            for depth, state in enumerate(leaf.states)
            for transition in state.transitions
            if self._is_triggered(transition)
        ]
        static = tuple(statement for state in reversed(leaf.states) for statement in _block(state.static, state))
        return self._first_of(leaf, transitions, static)

    def _is_triggered(self, transition: e.Transition) -> bool:
        # without a trigger of its own or of the machine, each trigger tests the transition
        return (transition.trigger or self.machine.default_trigger or self.trigger) == self.trigger

    def _first_of(
        self, leaf: _StatePath, transitions: list[tuple[int, e.Transition]], otherwise: e.Statements
    ) -> e.Statements:
        """Return the statements that take the first possible transition."""
        result = otherwise
        # built from the last transition to the first: each becomes the alternative of the one before
        for depth, transition in reversed(transitions):
            place = transition.place
            if transition.target not in self.junctions:
                body = self._take(leaf, depth, transition.target, (transition.action,), place)
                result = (e.If(transition.condition, body, result, place=place),)
                continue
            through = self._through(leaf, depth, transition, (transition.action,), 0)
            not_taken = e.Unary("!", e.Name(_TAKEN, place=place), place=place)
            result = (
                # a path through junctions may end without a state; then the next transition is tried
                _set_taken(False, place),
                e.If(transition.condition, through, place=place),
                e.If(not_taken, result, place=place),
            )
        return result

    def _through(
        self, leaf: _StatePath, depth: int, transition: e.Transition, actions: tuple[e.Statements, ...], passed: int
    ) -> e.Statements:
        """Return the statements behind a junction; the path is taken only if it leads to a state."""
        self.paths += 1
        if passed > _MAX_JUNCTIONS or self.paths > _MAX_PATHS:
            message = "a loop of junctions, or too many paths through them, is not supported"
            raise UnsupportedEsdlError(message, place=transition.place)
        result: e.Statements = ()
        for following in reversed(self.junctions[transition.target].transitions):
            place, path = following.place, (*actions, following.action)
            if following.target in self.junctions:
                body = self._through(leaf, depth, following, path, passed + 1)
                not_taken = e.Unary("!", e.Name(_TAKEN, place=place), place=place)
                result = (
                    e.If(following.condition, body, place=place),
                    e.If(not_taken, result, place=place),
                )
            else:
                body = (_set_taken(True, place), *self._take(leaf, depth, following.target, path, place))
                result = (e.If(following.condition, body, result, place=place),)
        return result

    def _take(
        self, leaf: _StatePath, depth: int, target: str, actions: tuple[e.Statements, ...], place: e.TextPosition
    ) -> e.Statements:
        """Return the statements of a transition that leaves the state at `depth` of the active ones."""
        if target not in self.by_name:
            raise UnsupportedEsdlError(f"the transition leads to an unknown state {target}", place=place)
        end = self.by_name[target]
        common = 0
        limit = min(depth, len(end.states) - 1)
        # states around both ends stay active, but the state that is left and the target are never among them: a
        # transition to itself, or from or to a state around, leaves and enters them
        while common < limit and leaf.states[common] is end.states[common]:
            common += 1
        left = leaf.states[common:]
        entered = end.states[common:]
        around = reversed(leaf.states[:common])
        statics = tuple(statement for state in around for statement in _block(state.static, state))
        kept = (state for state in left if state.keeps_history and _inner(state))
        return (
            *(statement for state in reversed(left) for statement in _block(state.exit, state)),
            # before a state is entered: a transition to the state itself enters what it leaves
            *(self._assigned(history_name(state.name), leaf.name, place) for state in kept),
            *(statement for action in actions for statement in action),
            *(statement for state in entered for statement in _block(state.entry, state)),
            *self._within(end, statics, place),
        )

    def _within(self, path: _StatePath, statics: e.Statements, place: e.TextPosition) -> e.Statements:
        """Return the statements that enter the inner states of a state, and then run the static actions around."""
        state = path.states[-1]
        inner = _inner(state)
        if not inner:
            return (*statics, self._assigned(STATE, path.name, place))
        if not state.keeps_history:
            return self._inner_entry(_started(path), statics, place)
        children = [_StatePath((*path.states, child)) for child in inner]
        cases = tuple((self._keys(child, place), self._inner_entry(child, statics, place)) for child in children)
        return (e.Switch(e.Name(history_name(state.name), place=place), cases, place=place),)

    def _inner_entry(self, path: _StatePath, statics: e.Statements, place: e.TextPosition) -> e.Statements:
        return (*_block(path.states[-1].entry, path.states[-1]), *self._within(path, statics, place))

    def _keys(self, path: _StatePath, place: e.TextPosition) -> tuple[e.Expression, ...]:
        """Return the numbers of the states without inner states within a state, or its own."""
        own = path.states[-1]
        names = [inner.name for inner in _paths((own,)) if inner.name in self.numbers]
        return tuple(e.Number(float(self.numbers[name]), False, place=place) for name in names)

    def _assigned(self, variable: str, state: str, place: e.TextPosition) -> e.Statement:
        if state not in self.numbers:
            raise UnsupportedEsdlError(f"the state {state} has no number", place=place)
        number = e.Number(float(self.numbers[state]), False, place=place)
        return e.Assign(e.Name(variable, place=place), number, place=place)


def _block(statements: e.Statements, state: e.State) -> e.Statements:
    return (e.Block(statements, place=state.place),) if statements else ()


def _set_taken(value: bool, place: e.TextPosition) -> e.Statement:
    return e.Assign(e.Name(_TAKEN, place=place), e.Truth(value, place=place), place=place)
