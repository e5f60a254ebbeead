"""Transitions tried in their order, through junctions, with the way back where none leads on.

Ways that meet again at a junction from which one always leads on are followed once from there: so a flow chart stays
as long as it is drawn, and a loop is unrolled turn by turn.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.errors import MEND
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.diagram import Arrow, Knot, State
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Fired", "Search", "sure_knots"]

_MOST_TURNS = 400  # of a loop among junctions
_DEEPEST = 150  # junctions on one way that may have to be gone back


class _Way(NamedTuple):
    """What has been passed so far: the transition actions to run, the states that the transitions are drawn in."""

    actions: tuple[tuple[tuple[m.Statement, ...], str], ...] = ()
    holders: frozenset[State] = frozenset()


@dataclass(eq=False)
class Fired:
    """A way that ends at a state; `guard` says where it is taken."""

    target: State
    way: _Way
    guard: Guard


@dataclass
class Search:
    """Follows the transitions from one place."""

    machine: "Machine"
    context: Context
    fired: list[Fired] = field(default_factory=list)
    _waiting: "dict[tuple[Knot | State, _Way], list[Guard]]" = field(default_factory=dict)
    _ended: list[Guard] = field(default_factory=list)
    _turns: dict[Knot, int] = field(default_factory=dict)
    _depth: int = 0

    def run(self, arrows: list[Arrow], guard: Guard) -> Guard | None:
        """Try transitions; `fired` has those that lead to states, what is returned is the guard where none does."""
        left = self._tried(arrows, guard, _Way())
        while (meeting := self._next()) is not None:
            guards = self._waiting.pop(meeting)
            begun = self.machine.logic.either(guards)
            if begun is not None and isinstance(meeting[0], Knot):
                self._turn(meeting[0])
                self._tried(meeting[0].arrows, begun, meeting[1])
        for (target, way), guards in self._waiting.items():
            taken = self.machine.logic.either(guards)
            if isinstance(target, State) and taken is not None:
                self.fired.append(Fired(target, way, taken))
        return self.machine.logic.either([left, *self._ended])

    def _next(self) -> "tuple[Knot | State, _Way] | None":
        """A junction where ways meet that no other such leads to, unless they lead to each other."""
        reach = self.machine.reach
        met = [(one, one[0]) for one in self._waiting if isinstance(one[0], Knot)]
        for one, knot in met:
            if not any(knot in reach[other] and other not in reach[knot] for _, other in met if other is not knot):
                return one
        return met[0][0] if met else None

    def _tried(self, arrows: list[Arrow], guard: Guard, way: _Way) -> Guard | None:
        """The guard where none of the transitions leads on."""
        left: Guard | None = guard
        for arrow in arrows:
            if left is None:
                return None
            self.machine.work()
            taken = self._taken(arrow, left)
            if taken is None:
                continue
            after = self.machine.statements.run(arrow.before, self.context.at(arrow.place), taken)
            back = self._reached(arrow, after, way) if after is not None else None
            left = self.machine.logic.besides(left, taken)
            if back is not None:
                left = self.machine.logic.either([left, back])
        return left

    def _taken(self, arrow: Arrow, guard: Guard) -> Guard | None:
        """The guard where a transition may be followed."""
        context = self.context.at(arrow.place)
        found = self.machine.events.happens(arrow.events, context, guard) if arrow.events else guard
        if found is None or arrow.condition is None:
            return found
        condition = self.machine.values.one(arrow.condition, context, found)
        return self.machine.logic.where(found, condition)

    def _reached(self, arrow: Arrow, guard: Guard, way: _Way) -> Guard | None:
        """Go on from the end of a transition; the guard where it has to be given up."""
        actions = (*way.actions, (arrow.after, arrow.place)) if arrow.after else way.actions
        way = _Way(actions, way.holders | {arrow.holder})
        target = arrow.target
        if isinstance(target, Knot) and target.history:
            target = target.holder
        if isinstance(target, State) or target in self.machine.sure:
            if isinstance(target, Knot) and not target.arrows:
                self._ended.append(guard)
            else:
                self._waiting.setdefault((target, way), []).append(guard)
            return None
        self._turn(target)
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self._endless(_DEEPEST)
        left = self._tried(target.arrows, guard, way)
        self._depth -= 1
        return left

    def _turn(self, knot: Knot) -> None:
        """Count how often a junction is passed."""
        self.machine.work()
        self._turns[knot] = self._turns.get(knot, 0) + 1
        if self._turns[knot] > _MOST_TURNS:
            raise self._endless(_MOST_TURNS)

    def _endless(self, most: int) -> UnsupportedError:
        what = f"its junctions make a loop of more than {most} turns, or one whose end depends on signals"
        return UnsupportedError(what, MEND)


def sure_knots(knots: list[Knot]) -> frozenset[Knot]:
    """The junctions that are never gone back from: where nothing leaves them, or one way is always free."""
    sure = {knot for knot in knots if not knot.arrows and not knot.history}
    while True:
        more = {
            knot
            for knot in knots
            if knot not in sure
            and any(
                arrow.free and (isinstance(arrow.target, State) or arrow.target.history or arrow.target in sure)
                for arrow in knot.arrows
            )
        }
        if not more:
            return frozenset(sure)
        sure |= more
