"""Choice of steady points to measure next, for the whole function, named parameters, or one undetermined direction."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.formatting import count_noun, join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.candidate_data import CandidateData
from kennfeld.design.coverage import never
from kennfeld.design.design_result import Design, stopped_early
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.information import Information
from kennfeld.design.measured_kinds import MeasuredKind, measured_kinds
from kennfeld.design.open_directions import (
    SETTLED,
    amount_of,
    factors_with,
    pick_direction,
    reduced_functions,
    regular_curvature,
)
from kennfeld.design.point_choice import PointChoice, PointSearch, Stop
from kennfeld.design.predicted_estimate import (
    NOTICEABLE,
    Curvature,
    curvatures_at,
    describe_range,
    deviation_range,
    deviations,
    expand_matrix,
)
from kennfeld.design.segment_design import describe_unsettled
from kennfeld.design.value_text import matching
from kennfeld.domain.criteria import Target
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.trust.direction_text import Direction

PLACE = Location("design")
MOST_CANDIDATES = 4000
MANY_POINTS = 100  # points of a kind that settle nothing if they leave more than 0.9 of a deviation
MOST_NODES = 12  # further nodes that are tried as a second criterion
BETTER = 0.8  # of what points leave, below which a second criterion is worth a sentence


PointOutcome = tuple[Design, Int]  # a design without its points, and the numbers of these among the candidates
PointWatch = Callable[[Callable[[], PointOutcome]], bool]  # as `Watch`


def design_points(
    fitted: FittedFunction,
    candidates: Mapping[str, Float],
    count: int,
    use: Sequence[Dataset],
    *,
    kind: MeasuredKind | None = None,
    names: Sequence[str] = (),
    direction: int | None = None,
    seed: int = 0,
    watch: PointWatch = never,
) -> PointOutcome:
    """Choose steady points.

    Args:
        fitted: the fit of the present data.
        candidates: channels of the points that can be measured, Float[candidates].
        count: number of points.
        use: the operation that matters, if neither names nor a direction are given.
        kind: what is measured there; by default as in most of the training data.
        names: patterns of the parameters to determine.
        direction: number of the undetermined direction to determine, from 1, in the order of the trust.
        seed: of the sets of values over which information is averaged.
        watch: is asked after each point, and before each exchange; True ends the search with those so far.

    Returns:
        The design without the points, and their numbers, Int[points].

    Raises:
        InputError: there are no candidates, or nothing that names or a direction stand for.
    """
    findings = Findings()
    kinds = measured_kinds(fitted)
    kind = kind or kinds[0]
    candidates, numbers = _distinct(candidates, findings)
    dataset = points_dataset(candidates, kind)
    data = CandidateData(fitted, [dataset], kind.criteria)
    rows, _, samples = data.rows(fitted.values)
    good = np.isfinite(rows).all(axis=(1, 2))
    if not good.all():
        message = f"{count_noun(int(np.sum(~good)), 'candidate')} left out, as the function has no finite value there"
        findings.warning(PLACE, message, "Check the inputs there.")
    rows, samples = rows[good], samples[good]
    if not samples.size:
        raise InputError.of(PLACE, "the function has no finite value at any candidate", "Check their inputs.")
    if samples.size < count:
        message = f"there are {count_noun(samples.size, 'candidate')}, fewer than the {count} asked for"
        findings.warning(PLACE, message, "Name more candidates, or widen the ranges.")
    rows[..., fitted.fixed] = 0.0
    shares = data.shares[0][:, samples].T
    columns, wanted = {name: values[samples] for name, values in candidates.items()}, min(count, samples.size)
    outcomes = _Outcomes(fitted, kind, columns, rows, shares, numbers[samples], wanted, findings.finish(), seed)
    if names or direction is not None:
        search = _ValueSearch(fitted, kind, rows, shares, names, direction)
        choice = search.choose(count, lambda made: watch(lambda: outcomes.of(made.chosen, [search.prediction(made)])))
        said, unsettled = search.sentences(choice, kinds, candidates)
        said += search.range_of(outcomes.curvatures(choice.chosen), choice)
        return outcomes.of(choice.chosen, said, unsettled)
    owners = np.full(dataset.samples, -1, dtype=np.int64)
    owners[samples] = np.arange(samples.size)
    information = Information.of(fitted, [dataset], [owners], samples.size, use, seed, measured=kind.criteria)
    cover = information.coverage

    def covering(chosen: Sequence[int]) -> PointOutcome:
        return outcomes.of(chosen, factor=cover.of([*chosen]) / cover.of([]))

    return covering(cover.choose(count, stop=lambda chosen: watch(lambda: covering(chosen))))


@dataclass(frozen=True, eq=False)
class _Outcomes:
    """Makes outcomes of chosen points.

    Attributes:
        fitted: the fit of the present data.
        kind: what is measured.
        columns: channels of the candidates, Float[candidates].
        rows: slopes of the outputs at each candidate, Float[candidates, outputs, free].
        shares: variance of the gradient per curvature, Float[candidates, outputs].
        numbers: of the candidates, as the caller counts them, Int[candidates].
        wanted: number of points that a search chooses which is not stopped.
        findings: on the candidates.
        seed: of the sets of values of a range.
    """

    fitted: FittedFunction
    kind: MeasuredKind
    columns: Mapping[str, Float]
    rows: Float
    shares: Float
    numbers: Int
    wanted: int
    findings: tuple[Finding, ...]
    seed: int

    def of(
        self,
        chosen: Sequence[int],
        sentences: Sequence[str] = (),
        unsettled: Sequence[str] | None = None,
        factor: float = float("nan"),
    ) -> PointOutcome:
        """Return the design of some candidates; by default what all directions say of what it leaves open."""
        own = self.rows[[*chosen]]
        added = np.einsum("kov,kow->vw", own, own)
        shares = self.shares[[*chosen]]
        scatter = np.einsum("kov,kow,ko->vw", own, own, shares)
        if unsettled is None:
            unsettled = describe_unsettled(self.fitted, added, scatter, f"These {self.kind.name} points")
        after = deviations(self.fitted, (added, scatter))
        least, most = deviation_range(self.fitted, after, self.curvatures(chosen), self.seed)
        design = Design(
            before=deviations(self.fitted),
            noise=dict(self.fitted.trust.noise),
            after=after,
            least=least,
            most=most,
            unsettled=tuple(unsettled),
            sentences=(*sentences, *describe_range(self.fitted, after, least, most)),
            findings=self.findings,
            factor=factor,
        )
        return stopped_early(design, len(chosen), self.wanted, "point"), self.numbers[[*chosen]]

    def curvatures(self, chosen: Sequence[int]) -> Curvature:
        """Return a function that computes the Gauss-Newton matrix of some candidates at any values."""
        columns = {name: values[[*chosen]] for name, values in self.columns.items()}
        return CandidateData(self.fitted, [points_dataset(columns, self.kind)], self.kind.criteria).curvature


def points_dataset(candidates: Mapping[str, Float], kind: MeasuredKind) -> Dataset:
    """Return candidates as a dataset whose points settle as those of the training data do."""
    channels = tuple(Channel(name, values, _unit(kind.example, name)) for name, values in candidates.items())
    return Dataset(kind.name, channels, settling=kind.example.settling)


def _unit(example: Dataset, name: str) -> str:
    return example[name].unit if name in example else ""


def _distinct(candidates: Mapping[str, Float], findings: Findings) -> tuple[dict[str, Float], Int]:
    """Return the candidates without duplicates and missing values, evenly thinned if they are very many."""
    stacked = np.column_stack(list(candidates.values()))
    complete = np.flatnonzero(np.isfinite(stacked).all(axis=1))
    if complete.size < len(stacked):
        message = f"{count_noun(len(stacked) - complete.size, 'candidate')} left out, as values are missing"
        findings.warning(PLACE, message)
    unique = np.sort(np.unique(stacked[complete], axis=0, return_index=True)[1])
    numbers = complete[unique]
    if numbers.size < complete.size:
        findings.remark(PLACE, f"{count_noun(complete.size - numbers.size, 'duplicate')} among the candidates left out")
    if numbers.size > MOST_CANDIDATES:
        findings.remark(PLACE, f"{MOST_CANDIDATES} of {numbers.size} candidates are looked at, evenly spread")
        numbers = numbers[np.linspace(0, numbers.size - 1, MOST_CANDIDATES).astype(np.int64)]
    return {name: values[numbers] for name, values in candidates.items()}, numbers


class _ValueSearch:
    """The search for points that determine named parameters or a direction, and what to say of it."""

    def __init__(
        self,
        fitted: FittedFunction,
        kind: MeasuredKind,
        rows: Float,
        shares: Float,
        names: Sequence[str],
        direction: int | None,
    ) -> None:
        self._fitted, self._kind, self._shares = fitted, kind, shares
        self._direction: Direction | None = None
        if direction is not None:
            self._direction = pick_direction(fitted, direction)
            self._functions = reduced_functions(fitted, [amount_of(fitted, self._direction)])
            self._sought = self._direction.sentence
        else:
            values = matching(names, fitted)
            if not values:
                raise InputError.of(Location("--for"), *_no_parameter(names, fitted))
            self._functions = reduced_functions(fitted, list(np.eye(fitted.values.size)[values]))
            self._sought = join_names(list(names))
        self._rows = self._reduced(rows)
        self._curvature = regular_curvature(fitted)
        rows_of = np.linalg.solve(self._curvature, self._functions.T)
        self._before = np.maximum(np.einsum("fi,if->f", self._functions, rows_of), 1e-300)

    def _reduced(self, rows: Float) -> Float:
        """Return rows over all free values, Float[candidates, outputs, free], over the independent ones."""
        flat = self._fitted.estimate.reduction.rows(rows.reshape(-1, rows.shape[-1]))
        return flat.reshape(*rows.shape[:2], -1)

    def choose(self, count: int, stop: Stop) -> PointChoice:
        return PointSearch(self._curvature, self._rows, self._functions).choose(count, stop=stop)

    def _left(self, rows: Float, shares: Float, count: int, *, repeats: bool = False) -> float:
        """Return what the best of other points leave; without exchanges, which change its third digit."""
        choice = PointSearch(self._curvature, rows, self._functions, repeats=repeats).choose(count, rounds=0)
        return self._factor(rows, shares, choice)

    def _factor(self, rows: Float, shares: Float, choice: PointChoice) -> float:
        """Return what a choice leaves, each criterion with a noise of its own."""
        if self._fitted.estimate.noise is None:
            return choice.factor
        own, noise = rows[[*choice.chosen]], shares[[*choice.chosen]]
        added, scatter = (np.einsum("kov,kow,ko->vw", own, own, each) for each in (np.ones_like(noise), noise))
        return float(np.sqrt(np.mean(factors_with(self._fitted, self._functions, added, scatter) ** 2)))

    def range_of(self, added: Curvature, choice: PointChoice) -> list[str]:
        """Return what a choice leaves at plausible values, as a sentence, unless it is what it leaves at the fit."""
        reduction, ridge = self._fitted.estimate.reduction, self._curvature - self._fitted.curvature
        smoothness = expand_matrix(self._fitted.estimate, self._fitted.estimate.smoothness)
        left = list[float]()
        for matrix in curvatures_at(self._fitted, added):
            curvature = np.asarray(reduction.matrix(matrix)) + smoothness + ridge
            variances = np.einsum("fi,if->f", self._functions, np.linalg.solve(curvature, self._functions.T))
            left.append(float(np.sqrt(np.mean(variances / self._before))))
        least, most = (extreme(left, default=1.0) for extreme in (min, max))
        if not left or max(most / left[0], left[0] / least) <= NOTICEABLE:
            return []
        middle = self._factor(self._rows, self._shares, choice)
        low, high = (middle * each / left[0] for each in (least, most))
        return [f"Values that are not known yet may make that {low:.2f} to {high:.2f}."]

    @property
    def _deviation(self) -> str:
        return "its deviation" if self._direction is not None else f"the deviation of {self._sought}"

    def prediction(self, choice: PointChoice) -> str:
        """Return what a choice leaves, in words."""
        points = count_noun(len(choice.chosen), "point")
        factor = self._factor(self._rows, self._shares, choice)
        return f"{points} of {self._kind.name} leave {factor:.2f} of {self._deviation}."

    def sentences(
        self, choice: PointChoice, kinds: Sequence[MeasuredKind], candidates: Mapping[str, Float]
    ) -> tuple[list[str], list[str]]:
        """Return predictions, and what no point settles."""
        count, of = len(choice.chosen), self._deviation
        said = [self.prediction(choice)]
        many = max(count, min(MANY_POINTS, len(self._rows)))
        own = self._factor(self._rows, self._shares, choice)
        left = own if many == count else min(self._left(self._rows, self._shares, many), own)
        others = [*self._other_kinds(kinds, count), *self._second_criteria(candidates, count)]
        better = sorted((other for other in others if other[0] < BETTER * own), key=lambda o: o[0])
        more = [f"{text} would leave {factor:.2f}." for factor, text in better[:3]]
        if left <= SETTLED:
            return [*said, *more], []
        verdict = f"{count_noun(many, 'point')} leave {left:.2f} of {of}."
        if self._direction is None:
            return said, [" ".join([f"No {self._kind.name} point settles it: {verdict}", *more])]
        pin = f"A pin does: {self._direction.remedy}" if self._direction.remedies else self._direction.remedy
        no_point = f"{self._sought} No {self._kind.name} point settles that: {verdict}"
        return said, [" ".join(filter(None, [no_point, *more, pin]))]

    def _other_kinds(self, kinds: Sequence[MeasuredKind], count: int) -> Iterator[tuple[float, str]]:
        """Yield what points of other kinds leave, at the places where such points were measured."""
        for kind in kinds:
            if kind.criteria != self._kind.criteria:
                names = [self._fitted.problem.channels.get(n, n) for n in self._fitted.problem.model.graph.inputs]
                columns = {name: kind.example[name].values for name in names}
                known = np.isfinite(np.column_stack(list(columns.values()))).all(axis=1)
                columns = {name: values[known] for name, values in columns.items()}
                rows, shares = self._finite_rows(
                    CandidateData(self._fitted, [points_dataset(columns, kind)], kind.criteria)
                )
                if len(rows):
                    # several measurements at one place count as well
                    factor = self._left(rows, shares, count, repeats=True)
                    yield factor, f"{count_noun(count, 'point')} as in {kind.name}"

    def _finite_rows(self, data: CandidateData) -> tuple[Float, Float]:
        """Return the reduced rows of the candidates of a dataset at which the function is defined, and their shares."""
        rows, _, samples = data.rows(self._fitted.values)
        good = np.isfinite(rows).all(axis=(1, 2))
        return self._reduced(rows[good]), data.shares[0][:, samples[good]].T

    def _second_criteria(self, candidates: Mapping[str, Float], count: int) -> Iterator[tuple[float, str]]:
        """Yield what the points leave if another node were measured as well, with the same relative noise."""
        problem = self._fitted.problem
        scored = {criterion.node for criterion in problem.criteria}
        scored |= {criterion.target.name for criterion in problem.criteria}
        first = self._kind.criteria[0]
        names = [name for name in problem.model.graph.names if name not in scored and not name.startswith("\0")]
        if not names or len(names) > MOST_NODES:
            return
        dataset = points_dataset(candidates, self._kind)
        simulator = NodeSimulator(problem.model.graph, problem.parameters, [first.node, *names])
        nodes = simulator.values(problem.bind(dataset), problem.parameters)
        spans = np.nanstd(nodes, axis=1)
        for name, span in zip(names, spans[1:].tolist(), strict=True):
            if not (np.isfinite(span) and span > 0 and spans[0] > 0):
                continue
            scale = first.scale * span / float(spans[0])
            other = replace(first, node=name, target=Target("channel", f"\0{name}"), scale=scale, loss="square")
            rows, shares = self._finite_rows(CandidateData(self._fitted, [dataset], [*self._kind.criteria, other]))
            if len(rows):
                factor = self._left(rows, shares, count)
                yield factor, f"Measuring {name} at {count_noun(count, 'point')} as well, with the same relative noise,"


def _no_parameter(names: Sequence[str], fitted: FittedFunction) -> tuple[str, str]:
    message = f"no free value of a parameter named {join_names(list(names), 3, ' or ')}"
    return message, nearest(names[0], fitted.blocks) or f"The free parameters are {join_names(list(fitted.blocks))}."
