"""One step of a chart: its states are executed, entered and left as the semantics of charts say, each under a guard."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from kennfeld.models.simulink.code.errors import MEND
from kennfeld.models.simulink.expressions.expressions import Expressions
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.stateflow.activity import Activity
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.counting import Counting
from kennfeld.models.simulink.stateflow.diagram import Diagram, Event, Knot, State
from kennfeld.models.simulink.stateflow.flows import Search, sure_knots
from kennfeld.models.simulink.stateflow.functions import Functions
from kennfeld.models.simulink.stateflow.guards import Guard, Logic
from kennfeld.models.simulink.stateflow.happenings import Events
from kennfeld.models.simulink.stateflow.statements import Statements
from kennfeld.models.simulink.stateflow.timers import Timers
from kennfeld.models.simulink.stateflow.transitions import Transitions
from kennfeld.models.simulink.stateflow.values import Values
from kennfeld.models.simulink.stateflow.variables import Variables
from kennfeld.models.simulink.variables.scopes import Scope
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["Machine"]

_MOST_WORK = 30_000
_DEEPEST = 12  # events sent, or functions called, within each other

Called = Callable[[Event, Guard], None]


class Machine:
    """Follows one step of a chart.

    `variables` hold what the step begins with and, in the end, what it leaves. `time` and `dt` are nodes in s.
    `called` is told of output events that call functions.
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
        self.time, self.dt = clock
        self.called = called
        self.activity = Activity(self)
        self.transitions = Transitions(self)
        self.events = Events(self)
        self.counting = Counting(self)
        self.functions = Functions(self)
        self._done = 0
        self._depth = 0
        knots = list(diagram.knots)
        self.sure = sure_knots(knots)
        self.reach = {knot: _reached(knot) for knot in knots}

    def work(self) -> None:
        """Count a piece of work; what would never end is refused."""
        self._done += 1
        if self._done > _MOST_WORK:
            raise UnsupportedError(f"its chart unfolds to more than {_MOST_WORK} actions", MEND)

    @contextmanager
    def deeper(self, what: str) -> Iterator[None]:
        """What is followed within something else; refused where that has no end."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise UnsupportedError(f"it {what} without an end, or more than {_DEEPEST} deep", MEND)
        yield
        self._depth -= 1

    def wake(self, guard: Guard, event: str = "") -> None:
        """One execution of the chart."""
        root = self.diagram.root
        context = Context(root, root, event, place="the chart")
        self.counting.count(event, guard)
        active = self.variables.one("active", guard)
        first = self.logic.where(guard, active, holds=False)
        later = self.logic.where(guard, active)
        self.variables.put("active", self.loom.const(1.0), guard)
        self._watch(first, guard)
        if not root.children:
            self.flow(root, context, guard)
            return
        if first is not None:
            self.activity.clear(root, first)
            self.activity.enter_children(root, context, first)
        if later is not None:
            self.counting.measure(context, later)
            self.activity.children(root, context, later)

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
            self.activity.clear(root, guard)
            self.activity.enter_children(root, context, guard)
        else:
            self.flow(root, context, guard)

    def flow(self, root: State, context: Context, guard: Guard) -> None:
        """The flow chart of a chart without states, or of a function."""
        search = Search(self, context)
        search.run(root.defaults, guard)
        if search.fired:
            raise UnsupportedError(f"{context.place} leads from a flow chart into a state")

    def check_writable(self, key: str, context: Context) -> None:
        """Refuse an assignment to what a chart may only read."""
        data = next((one for one in self.diagram.data.values() if one.key == key), None)
        if data is not None and data.written.scope in ("INPUT_DATA", "CONSTANT_DATA"):
            raise UnsupportedError(f"{context.place}: it assigns to {key}, which it may only read")


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
