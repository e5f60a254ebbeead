"""One step of a chart: states are entered, executed and left as the semantics of charts say, each under a guard."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.expressions import Expressions
from kennfeld.models.simulink.scopes import Scope
from kennfeld.models.simulink.signals import Nodes
from kennfeld.models.simulink.stateflow.diagram import Action, Arrow, Diagram, Event, Knot, State
from kennfeld.models.simulink.stateflow.flows import Fired, Search, sure_knots
from kennfeld.models.simulink.stateflow.functions import Functions
from kennfeld.models.simulink.stateflow.guards import Guard, Logic
from kennfeld.models.simulink.stateflow.statements import Statements
from kennfeld.models.simulink.stateflow.timers import SECONDS, TEMPORAL, TICKS, Timers, unit_of
from kennfeld.models.simulink.stateflow.timing import Timing
from kennfeld.models.simulink.stateflow.values import Context, Values
from kennfeld.models.simulink.stateflow.variables import Variables
from kennfeld.models.simulink.unsupported import UnsupportedError

__all__ = ["Machine"]

_MOST_WORK = 30_000
_FEW = 12  # children; what many of them do is followed apart, so that one does not burden the next
_DEEPEST = 12  # events sent, or functions called, within each other
_MEND = "Draw it as blocks, or bind its outputs."
_IMPLICIT = {"en": "entry", "enter": "entry", "entry": "entry", "ex": "exit", "exit": "exit"}
_CHANGED = ("change", "chg")

Called = Callable[[Event, Guard], None]


class Machine:
    """Follows one step of a chart.

    `variables` hold what the step begins with and, in the end, what it leaves. `clock` are the nodes of time and step
    in s. `called` is told of output events that call functions.
    """

    def __init__(
        self,
        diagram: Diagram,
        timers: Timers,
        expressions: Expressions,
        scope: Scope,
        values: Mapping[str, Nodes],
        sized: frozenset[str],
        clock: tuple[int, int],
        called: Called,
    ) -> None:
        self.diagram = diagram
        self.timers = timers
        self.logic = Logic(expressions.loom)
        self.loom = expressions.loom
        self.variables = Variables(self.logic, values, sized)
        self.values = Values(self, expressions, scope)
        self.statements = Statements(self, self.values)
        self.timing = Timing(self, timers, *clock)
        self.functions = Functions(self)
        self.called = called
        self.sent = 0
        self._done = 0
        self._depth = 0
        knots = list(diagram.knots)
        self.sure = sure_knots(knots)
        self.reach = {knot: _reached(knot) for knot in knots}
        self._implicit = _implicit(diagram)

    def work(self) -> None:
        """Count a piece of work; what would never end is refused."""
        self._done += 1
        if self._done > _MOST_WORK:
            raise UnsupportedError(f"its chart unfolds to more than {_MOST_WORK} actions", _MEND)

    # the chart

    def wake(self, guard: Guard, event: str = "") -> None:
        """One execution of the chart."""
        root = self.diagram.root
        context = Context(root, root, event, place="the chart")
        self.timing.count(event, guard)
        active = self.variables.one("active", guard)
        first = self.logic.where(guard, active, holds=False)
        later = self.logic.where(guard, active)
        self.variables.put("active", self.loom.const(1.0), guard)
        self._watch(first, guard)
        if not root.children:
            self.flow(root, context, guard)
            return
        if first is not None:
            self._clear(root, first)
            self.enter_children(root, context, first)
        if later is not None:
            self.timing.measure(context, later)
            self._children(root, context, later)

    def _watch(self, first: Guard | None, guard: Guard) -> None:
        """Note what the variables hold whose changes are asked for; in the first step nothing has changed."""
        for key in self.timers.watched:
            value = self.variables.get(key, guard)
            self.variables.set(f"before {key}", self.variables.get(f"now {key}", guard), guard)
            self.variables.set(f"now {key}", value, guard)
            if first is not None:
                self.variables.set(f"before {key}", value, first)

    def begin(self, guard: Guard) -> None:
        """Enter the chart before the first step."""
        root = self.diagram.root
        context = Context(root, root, place="the chart")
        self.variables.put("active", self.loom.const(1.0), guard)
        if root.children:
            self._clear(root, guard)
            self.enter_children(root, context, guard)
        else:
            self.flow(root, context, guard)

    def flow(self, root: State, context: Context, guard: Guard) -> None:
        """The flow chart of a chart without states, or of a function."""
        search = Search(self, context)
        search.run(root.defaults, guard)
        if search.fired:
            raise UnsupportedError(f"{context.place} leads from a flow chart into a state")

    # states

    def active(self, state: State, guard: Guard) -> int:
        """The node that says whether a state is active."""
        if state.parent is None:
            return self.loom.const(1.0)
        if state.parent.parallel:
            return self.variables.one(f"active {state.id}", guard)
        child = self.variables.one(f"child {state.parent.id}", guard)
        return self.loom.call("eq", child, self.loom.const(float(state.number)))

    def _still(self, state: State) -> Callable[[Guard], Guard | None]:
        """Gives the guard where a state is still active."""
        return lambda guard: self.logic.where(guard, self.active(state, guard))

    def _execute(self, state: State, context: Context, guard: Guard) -> None:
        """An active state: its outer transitions, else its actions, its inner transitions and its children."""
        self.work()
        here = replace(context, scope=state, owner=state, alive=self._still(state), frame="")
        left = self._transitions(state, state.outer, here, guard)
        for action in state.actions:
            if left is not None and action.kind in ("during", "on"):
                left = self._during(action, state, here, left)
        if left is not None:
            left = self._transitions(state, state.inner, here, left)
        if left is not None:
            self._children(state, here, left)

    def _during(self, action: Action, state: State, context: Context, guard: Guard) -> Guard | None:
        context = context.at(f"its state {state.path}")
        where = self.happens(action.event, context, guard) if action.kind == "on" else guard
        end = self.statements.run(action.body, context, where)
        return guard if end is where else self.logic.either([self.logic.besides(guard, where), end])

    def _children(self, state: State, context: Context, guard: Guard) -> None:
        """Execute the children of a state that are active."""
        if state.parallel:
            for child in state.children:
                still = self._still(state)(guard)
                where = self.logic.where(still, self.active(child, still)) if still is not None else None
                if where is not None:
                    self._execute(child, context, where)
            return
        ways = self._each_child(state, guard)
        if len(ways) <= _FEW:
            for child, where in ways:
                self._execute(child, context, where)
            return
        before = self.variables.values
        after = []
        for child, where in ways:
            self.variables.values = dict(before)
            self._execute(child, context, where)
            after.append((where, self.variables.values))
        self.variables.values = self.variables.joined(before, after)

    def _each_child(self, state: State, guard: Guard) -> list[tuple[State, Guard]]:
        """The children of a state that may be active now, each with the guard where it is."""
        if not state.children:
            return []
        now = self.variables.one(f"child {state.id}", guard)
        found = []
        for child in state.children:
            equal = self.loom.call("eq", now, self.loom.const(float(child.number)))
            where = self.logic.where(guard, equal)
            if where is not None:
                found.append((child, where))
        return found

    # transitions

    def _transitions(self, state: State, arrows: list[Arrow], context: Context, guard: Guard) -> Guard | None:
        """Take the first transition that can be; the guard where none is."""
        if not arrows:
            return guard
        search = Search(self, context)
        left = search.run(arrows, guard)
        for one in search.fired:
            self._fire(one, state, context)
        return left

    def _fire(self, fired: Fired, source: State, context: Context) -> None:
        """Leave the states up to the one that the way is drawn in, run the transition's actions, and enter others."""
        top = _outermost(fired.way.holders)
        guard: Guard | None = fired.guard
        inside = top is source or source in top.around
        if top.parallel and not (inside and top is source):
            guard = self._leave_parallel(top, source, fired.target, context, fired.guard)
        else:
            guard = self._leave_children(top, context, fired.guard)
        quiet = self._calm(top)
        for body, place in fired.way.actions:
            here = replace(context, owner=source, alive=quiet, place=place)
            guard = self.statements.run(body, here, guard)
        if guard is not None:
            self._enter_way(top, fired.target, context, guard)

    def _leave_parallel(self, top: State, source: State, target: State, context: Context, guard: Guard) -> Guard | None:
        raise UnsupportedError(f"a transition from its state {source.path} to {target.path} crosses parallel states")

    def _calm(self, top: State) -> Callable[[Guard], Guard | None]:
        """Gives the guard where a state is active without an active child, so that a transition in it may go on."""

        def calm(guard: Guard) -> Guard | None:
            found = self.logic.where(guard, self.active(top, guard))
            if found is None or top.parallel or not top.children:
                return found
            child = self.variables.one(f"child {top.id}", found)
            return self.logic.where(found, self.loom.call("eq", child, self.loom.const(0.0)))

        return calm

    def _enter_way(self, top: State, target: State, context: Context, guard: Guard) -> None:
        """Enter the states below one, down to a target and what is entered with it."""
        if target is top:
            self.enter_children(top, context, guard)
            return
        way = [target]
        while way[0].parent is not None and way[0].parent is not top:
            way.insert(0, way[0].parent)
        if way[0].parent is None:
            raise UnsupportedError(f"a transition into its state {target.path} is drawn where it cannot be")
        self._enter(way, context, guard)

    def _enter(self, way: list[State], context: Context, guard: Guard) -> None:
        state, rest = way[0], way[1:]
        self.work()
        after = self._entered(state, context, guard)
        if after is None:
            return
        if not rest:
            self.enter_children(state, context, after)
        elif state.parallel:
            for child in state.children:
                self._enter(rest if child is rest[0] else [child], context, after)
        else:
            self._enter(rest, context, after)

    def _entered(self, state: State, context: Context, guard: Guard) -> Guard | None:
        """Mark a state as active, and run its entry actions."""
        assert state.parent is not None
        if state.parent.parallel:
            self.variables.put(f"active {state.id}", self.loom.const(1.0), guard)
        else:
            number = self.loom.const(float(state.number))
            self.variables.put(f"child {state.parent.id}", number, guard)
            if state.parent.history:
                self.variables.put(f"history {state.parent.id}", number, guard)
        self._clear(state, guard)
        self.timing.restart(state, guard)
        after = self._acted(state, "entry", context, guard)
        if after is None:
            return None
        self._tell("entry", state, after)
        return self._still(state)(after)

    def _clear(self, state: State, guard: Guard) -> None:
        """Note that no child of a state is active, which holds whenever it is entered."""
        names = [f"active {one.id}" for one in state.children] if state.parallel else [f"child {state.id}"]
        for name in names if state.children else ():
            self.variables.put(name, self.loom.const(0.0), guard)

    def _acted(self, state: State, kind: str, context: Context, guard: Guard) -> Guard | None:
        here = replace(
            context, scope=state, owner=state, alive=self._still(state), place=f"its state {state.path}", frame=""
        )
        found: Guard | None = guard
        for action in state.actions:
            if action.kind == kind:
                found = self.statements.run(action.body, here, found)
        return found

    def enter_children(self, state: State, context: Context, guard: Guard) -> None:
        """Enter what goes with a state that has just become active: by its history, else by its default transitions."""
        if state.parallel:
            for child in state.children:
                self._enter([child], context, guard)
            return
        left: Guard | None = guard
        if state.history:
            last = self.variables.one(f"history {state.id}", guard)
            for child in state.children:
                where = self.logic.where(guard, self.loom.call("eq", last, self.loom.const(float(child.number))))
                if where is not None:
                    self._enter([child], context, where)
            left = self.logic.where(guard, self.loom.call("eq", last, self.loom.const(0.0)))
        if left is not None and state.defaults:
            here = replace(context, scope=state, owner=state, alive=self._still(state), frame="")
            self._transitions(state, state.defaults, here, left)

    # leaving

    def _leave_children(self, state: State, context: Context, guard: Guard) -> Guard | None:
        """Leave the children of a state that are active, the last of parallel ones first."""
        if not state.parallel:
            ways = [self._leave(child, context, where) for child, where in self._each_child(state, guard)]
            return self._after(state, guard, ways)
        found: Guard | None = guard
        for child in reversed(state.children):
            if found is None:
                return None
            where = self.logic.where(found, self.active(child, found))
            if where is not None:
                self._leave(child, context, where)
        return found

    def _after(self, state: State, guard: Guard, ways: list[Guard | None]) -> Guard | None:
        """The guard after the children have been left, unless an event that one of them has sent left the state too."""
        return guard if None not in ways else self.logic.where(guard, self.active(state, guard))

    def _leave(self, state: State, context: Context, guard: Guard) -> Guard | None:
        self.work()
        assert state.parent is not None
        inner = self._leave_children(state, context, guard)
        after = self._acted(state, "exit", context, inner) if inner is not None else None
        if after is None:
            return None
        name = f"active {state.id}" if state.parent.parallel else f"child {state.parent.id}"
        self.variables.put(name, self.loom.const(0.0), after)
        self._tell("exit", state, after)
        return self._still(state.parent)(after)

    # events

    def happens(self, events: tuple[m.Expression, ...], context: Context, guard: Guard) -> Guard | None:
        """The guard where any of several events is what is being processed."""
        return self.logic.either([self._happens(event, context, guard) for event in events])

    def _happens(self, tree: m.Expression, context: Context, guard: Guard) -> Guard | None:
        name = tree.of.name if isinstance(tree, m.Call) and isinstance(tree.of, m.Name) else ""
        if isinstance(tree, m.Call) and name in TEMPORAL:
            return self._timed(name, tree.arguments, context, guard)
        if isinstance(tree, m.Call) and (name in _IMPLICIT or name in _CHANGED):
            return guard if context.event == self._implied(name, tree, context) else None
        if isinstance(tree, m.Name) and tree.name in TICKS and self.diagram.event(tree.name, context.scope) is None:
            return guard if self.is_waking(context.event) else None
        found = self.values.event(tree, context)
        if found is None:
            raise UnsupportedError(f"{context.place}: it waits for what is no event of the chart")
        return guard if context.event == found[0].key else None

    def is_waking(self, event: str) -> bool:
        """Whether what is processed comes from outside, not from the chart itself."""
        return not event or any(one.key == event for one in self.diagram.inputs)

    def _timed(self, name: str, arguments: tuple[m.Expression, ...], context: Context, guard: Guard) -> Guard | None:
        unit = unit_of(name, arguments) if name != "duration" else "sec"
        if unit in TICKS and not self.is_waking(context.event):
            return None
        event = self.diagram.event(unit, context.scope)
        if unit not in TICKS and unit not in SECONDS and (event is None or event.key != context.event):
            return None
        return self.logic.where(guard, self.timing.temporal(name, arguments, context, guard))

    def _implied(self, name: str, tree: m.Call, context: Context) -> str:
        """The key of the event that a state is entered or left, or a variable is changed."""
        argument = tree.arguments[0] if len(tree.arguments) == 1 else m.Number(0.0)
        if name in _CHANGED:
            key = self.values.key_of(argument, context)
            if key is None:
                raise UnsupportedError(f"{context.place}: {name} asks for what is no variable of the chart")
            return f"change {key}"
        return f"{_IMPLICIT[name]} {self.values.state(argument, context).id}"

    def _tell(self, kind: str, state: State, guard: Guard) -> None:
        """Process the event that a state was entered or left, where a label asks for it."""
        if (kind, state.name) in self._implicit:
            self._broadcast(f"{kind} {state.id}", self.diagram.root, guard)

    def written(self, key: str, old: Nodes, guard: Guard, context: Context) -> None:
        """Process the event that a variable has changed, where a label asks for it."""
        if ("change", key.rpartition(".")[2]) not in self._implicit:
            return
        pairs = zip(self.variables.get(key, guard).ravel(), self.logic.simplified(old, guard).ravel(), strict=True)
        for new, before in pairs:
            differs = self.loom.call("ne", int(new), int(before)) if new != before else self.loom.const(0.0)
            where = self.logic.where(guard, differs)
            if where is not None:
                self._broadcast(f"change {key}", self.diagram.root, where)

    def send(self, event: Event, to: State | None, context: Context, guard: Guard) -> None:
        """Process an event at once: in the state that it is sent to, else in the one that it belongs to."""
        if event.written.scope == "OUTPUT_EVENT":
            self._emit(event, guard)
            return
        if event.written.scope != "LOCAL_EVENT":
            raise UnsupportedError(f"{context.place}: it sends {event.written.name}, which comes from outside")
        self.timing.count(event.key, guard)
        self._broadcast(event.key, to or event.owner, guard)

    def _emit(self, event: Event, guard: Guard) -> None:
        if event.written.trigger == "FUNCTION_CALL_EVENT":
            self.called(event, guard)
            return
        key = f"output {event.key}"
        now = self.variables.one(key, guard)
        self.variables.put(key, self.loom.call("sub", self.loom.const(1.0), now), guard)

    def _broadcast(self, event: str, to: State, guard: Guard) -> None:
        self.sent += 1
        self.deeper("sends events to itself")
        where = self.logic.where(guard, self.active(to, guard))
        context = Context(to, to, event, place=f"its state {to.path}" if to.path else "the chart")
        if where is not None and to.parent is None:
            self._children(to, context, where)
        elif where is not None:
            self._execute(to, context, where)
        self._depth -= 1

    def deeper(self, what: str) -> None:
        """Begin something that may come again within itself; raises `UnsupportedError` where it does so too often."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise UnsupportedError(f"it {what} without an end, or more than {_DEEPEST} deep", _MEND)

    def shallower(self) -> None:
        """End what `deeper` has begun."""
        self._depth -= 1

    def check_writable(self, key: str, context: Context) -> None:
        """Refuse an assignment to what a chart may only read."""
        data = next((one for one in self.diagram.data.values() if one.key == key), None)
        if data is not None and data.written.scope in ("INPUT_DATA", "CONSTANT_DATA"):
            raise UnsupportedError(f"{context.place}: it assigns to {key}, which it may only read")


def _outermost(holders: frozenset[State]) -> State:
    return min(holders, key=lambda state: len(list(state.around)))


def _reached(knot: Knot) -> frozenset[Knot]:
    """The junctions that transitions from one lead to."""
    seen: set[Knot] = set()
    waiting = [knot]
    while waiting:
        for arrow in waiting.pop().arrows:
            if isinstance(arrow.target, Knot) and arrow.target not in seen:
                seen.add(arrow.target)
                waiting.append(arrow.target)
    return frozenset(seen)


def _implicit(diagram: Diagram) -> frozenset[tuple[str, str]]:
    """The implicit events that labels ask for: the kind of each, and the name of the state or variable."""
    found: set[tuple[str, str]] = set()
    for event in diagram.awaited:
        if not isinstance(event, m.Call) or not isinstance(event.of, m.Name) or len(event.arguments) != 1:
            continue
        kind = "change" if event.of.name in _CHANGED else _IMPLICIT.get(event.of.name, "")
        argument = event.arguments[0]
        if isinstance(argument, (m.Name, m.Field)):
            found.add((kind, argument.name))
    return frozenset(found)
