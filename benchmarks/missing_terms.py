"""Topic `missing`: planted terms in steady and transient functions, which `propose` has to find among bait channels."""

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

import kennfeld as kf
from benchmarks.measure import installed
from benchmarks.table import Table
from kennfeld.base.arrays import Float
from kennfeld.project.demo import torque

CASES = 200  # half of them with a missing term
EFFECTS = (0.3, 1.0, 3.0)  # RMSE of the effect in standard deviations of the noise
BAIT = 15
CORRELATION = 0.95  # of neighbouring errors, where they are correlated

TORQUE_EQUAL = {
    "product": {"TorquePredict", "etaSpark", "product", "trqOpt"},
    "dragTorque": {"dragTorque", "TorquePredict", "product", "trqOpt"},
    "ignOpt": {"ignOpt", "deltaSpark"},
}


@dataclass(frozen=True)
class Case:
    """A function, data with a planted term, and where it may be found."""

    name: str
    text: str
    data: list[dict[str, Float]]
    start: kf.ParameterSet
    target: str
    channel: str  # "" without a term
    nodes: frozenset[str]
    effect: float
    settings: Mapping[str, Any] = field(default_factory=dict)


def cases(count: int = CASES, seed: int = 0) -> Iterator[Case]:
    """Yield cases of all functions in turn, with a term and without."""
    makers = (_torque_case, _exhaust_case, _surrogate_case)
    for number in range(count):
        maker = makers[number // 2 % 3]
        yield maker(np.random.default_rng([seed, number]), number // 6, planted=number % 2 == 0)


def _shape(x: Float, which: int) -> Float:
    x = (x - x.mean()) / x.std()
    shape = (x, x**2, np.tanh(2 * x))[which % 3]
    return (shape - shape.mean()) / shape.std()


def _noise(rng: np.random.Generator, count: int, deviation: float, *, correlated: bool) -> Float:
    white = rng.normal(0, 1, count)
    if not correlated:
        return deviation * white
    from scipy.signal import lfilter

    start = [CORRELATION * rng.normal()]
    return deviation * lfilter([np.sqrt(1 - CORRELATION**2)], [1, -CORRELATION], white, zi=start)[0]


def _bait(rng: np.random.Generator, count: int, *, timed: bool) -> dict[str, Float]:
    """Return channels that no case but their own needs; some are correlated with each other, some walk."""
    columns = {f"c{number}": rng.normal(size=count) for number in range(BAIT)}
    if timed:
        from scipy.signal import lfilter

        for number in range(BAIT):
            pole = (0.5, 0.9, 0.98)[number % 3]
            columns[f"c{number}"] = lfilter([np.sqrt(1 - pole**2)], [1, -pole], columns[f"c{number}"])
        columns["c14"] = np.cumsum(rng.normal(size=count)) / np.sqrt(count)
    columns["c1"] = 0.8 * columns["c0"] + 0.6 * columns["c1"]
    columns["c3"] = 0.6 * columns["c2"] + 0.8 * columns["c3"]
    return columns


@cache
def _fitted_torque() -> tuple[str, kf.ParameterSet, dict[str, Float], Mapping[str, Any]]:
    bench = torque.bench()
    data = {name: bench[name].values.copy() for name in bench}
    text = TORQUE
    settings = {
        "node": "TorquePredict",
        "smoothness": {"MapOptTorque": 100, "MapOptIgnition": 10, "CurveEtaDeltaSpark": 1e4, "MapDragTorque": 100},
        "bounds": {
            **{"CurveEtaDeltaSpark": (0, 1), "MapOptTorque": (0, 600)},
            **{"MapOptIgnition": (0, 60), "MapDragTorque": (0, 200)},
        },
        "pins": [kf.Pin("CurveEtaDeltaSpark", (0,), 1.0), kf.Pin("MapOptIgnition", (3700, 64), 32.5)],
    }
    fit = kf.calibrate(text, data, torque.start(), "Torque", **settings)
    return text, fit.parameters, data, settings


TORQUE = """trqOpt = MapOptTorque(Speed, Rel_Airmass)
ignOpt = MapOptIgnition(Speed, Rel_Airmass)
deltaSpark = ignOpt - Ignition
etaSpark = CurveEtaDeltaSpark(deltaSpark)
product = trqOpt * etaSpark
dragTorque = MapDragTorque(Speed, Rel_Airmass)
TorquePredict = product - dragTorque
"""


def _torque_case(rng: np.random.Generator, number: int, *, planted: bool) -> Case:
    text, parameters, bench, settings = _fitted_torque()
    data = {name: bench[name] for name in ("Speed", "Rel_Airmass", "Ignition")}
    count, deviation = bench["Torque"].size, 1.8
    bait = _bait(rng, count, timed=False)
    node = ("product", "dragTorque", "ignOpt", "product", "dragTorque")[number % 5] if planted else ""
    effect, channel = EFFECTS[number % 3], f"c{(0, 2, 5, 6)[rng.integers(4)]}"
    term = _shape(bait[channel], int(rng.integers(3)))
    lines = dict(line.split(" = ", 1) for line in text.splitlines())
    if node:
        lines[node] = f"({lines[node]}) * (1 + k * term)" if node == "product" else f"{lines[node]} + k * term"
    complete = "\n".join(f"{name} = {value}" for name, value in lines.items())
    y = _planted(complete, "TorquePredict", data, term, parameters, effect * deviation if node else 0.0)
    data = data | bait | {"Torque": y + _noise(rng, count, deviation, correlated=False)}
    nodes = frozenset(TORQUE_EQUAL.get(node, set()))
    return Case(f"torque {node}", text, [data], parameters, "Torque", channel if node else "", nodes, effect, settings)


def _planted(
    text: str, node: str, data: Mapping[str, Float], term: Float, parameters: kf.ParameterSet, effect: float
) -> Float:
    """Return the output of a function with a term, of such a size that its effect has this RMSE."""

    def simulated(k: float) -> Float:
        values = kf.ParameterSet([*parameters.values(), kf.Scalar("k", k)])
        return kf.simulate(text, {**data, "term": term}, values)[node].values

    if not effect:
        return simulated(0.0) if "term" in text else kf.simulate(text, dict(data), parameters)[node].values
    plain, unit = simulated(0.0), 1e-3
    size = float(np.sqrt(np.mean((simulated(unit) - plain) ** 2)))
    return simulated(unit * effect / size)


def _exhaust_case(rng: np.random.Generator, number: int, *, planted: bool) -> Case:
    text, target, inputs, parameters, pieces = _fitted_exhaust()
    count = len(pieces[0]["time"])
    deviation, correlated = 3.0, number % 2 == 1
    node = ("settled", "output")[number // 2 % 2] if planted else ""
    effect, channel = EFFECTS[number % 3], f"c{(0, 2, 5, 6)[rng.integers(4)]}"
    names = {"settled": inputs["settled"], "output": inputs["output"]}
    bait = [_bait(rng, count, timed=True) for _ in pieces]
    whole = np.concatenate([own[channel] for own in bait])
    which = int(rng.integers(3))
    term = np.split(_shape(whole, which), len(pieces))
    lines = dict(line.split(" = ", 1) for line in text.splitlines())
    if node:
        lines[names[node]] = f"{lines[names[node]]} + k * term"
    complete = "\n".join(f"{name} = {value}" for name, value in lines.items())
    data = []
    for own, piece, part in zip(bait, pieces, term, strict=True):
        y = _planted(complete, names["output"], piece, part, parameters, effect * deviation if node else 0.0)
        data.append(piece | own | {target: y + _noise(rng, count, deviation, correlated=correlated)})
    nodes = {"settled": {names["settled"]}, "output": {names["output"]}, "": set[str]()}[node]
    settings = {"node": names["output"], "smoothness": inputs["smoothness"]}
    label = f"exhaust {node}{' AR' if correlated else ''}"
    return Case(label, text, data, parameters, target, channel if node else "", frozenset(nodes), effect, settings)


STARTS = range(0, 26400, 8800)  # samples of the drive, cut into three


@cache
def _fitted_exhaust() -> tuple[str, str, dict[str, Any], kf.ParameterSet, list[dict[str, Float]]]:
    import tempfile
    from pathlib import Path

    from kennfeld.project.demo.writing import write

    with tempfile.TemporaryDirectory() as folder:
        project = kf.Project.read(write("exhaust", Path(folder) / "demo"))
        problem = project.problem()
        text = (project.path.parent / project.file.model.file).read_text(encoding="utf-8")
    lines = [line.split("#")[0].strip() for line in text.splitlines() if "=" in line.split("#")[0]]
    plain = "\n".join(f"{line.split('=')[0].split('[')[0].strip()} = {line.split('=', 1)[1].strip()}" for line in lines)
    data = problem.fitted_datasets[0]
    names = [line.split(" = ")[0] for line in plain.splitlines()]
    output = problem.criteria[0].node
    settled = next(name for name in names if name != output)
    target = problem.criteria[0].target.name
    columns = {name: data[name].values for name in problem.model.graph.inputs} | {"time": data.time}
    pieces = [{name: values[a : a + 8800] for name, values in columns.items()} for a in range(0, 18800, 8800)]
    fitted = [piece | {target: data[target].values[a : a + 8800]} for a, piece in zip(STARTS, pieces, strict=True)]
    smoothness = dict(problem.smoothness)
    fit = kf.calibrate(plain, fitted, problem.parameters, target, node=output, smoothness=smoothness)
    keys = {"settled": settled, "output": output, "smoothness": dict(problem.smoothness)}
    return plain, target, keys, fit.parameters, pieces


SURROGATE = """air = CurveAir(u)
heat = MapHeat(u, v)
level = PT1(air + heat, T)
y = level * CurveGain(w)
"""


def _surrogate_case(rng: np.random.Generator, number: int, *, planted: bool) -> Case:
    """Return a case of a function of one's own: two branches, a lag and a factor behind it."""
    from scipy.signal import lfilter

    deviation, correlated = 0.5, number % 2 == 0
    # of correlated errors, the mean of fewer would hide the smallest effect
    count = 4000 if correlated else 1500
    grid = np.linspace(-2, 2, 6)
    parameters = kf.ParameterSet(
        [
            kf.Curve("CurveAir", kf.Axis(grid, "u"), 5 + 2 * grid),
            kf.Map("MapHeat", kf.Axis(grid, "u"), kf.Axis(grid, "v"), 3 + np.add.outer(np.sin(grid), grid**2)),
            kf.Curve("CurveGain", kf.Axis(grid, "w"), 1 + 0.1 * grid),
            kf.Scalar("T", 2.0),
        ]
    )
    node = ("heat", "level", "y")[number // 2 % 3] if planted else ""
    effect, channel = EFFECTS[number % 3], f"c{(0, 2, 5, 6)[rng.integers(4)]}"
    lines = dict(line.split(" = ", 1) for line in SURROGATE.splitlines())
    if node:
        lines[node] = f"{lines[node]} + k * term" if node != "y" else f"{lines[node]} * (1 + k * term)"
    complete = "\n".join(f"{name} = {value}" for name, value in lines.items())
    data, which, pieces = [], int(rng.integers(3)), []
    for _ in range(3):
        own = {n: 2 * np.tanh(lfilter([0.2], [1, -0.98], rng.normal(size=count))) for n in "uvw"}
        pieces.append(own | {"time": 0.1 * np.arange(count)} | _bait(rng, count, timed=True))
    term = np.split(_shape(np.concatenate([piece[channel] for piece in pieces]), which), 3)
    for piece, part in zip(pieces, term, strict=True):
        y = _planted(complete, "y", piece, part, parameters, effect * deviation if node else 0.0)
        data.append(piece | {"m": y + _noise(rng, count, deviation, correlated=correlated)})
    nodes = {"heat": {"heat", "air"}, "level": {"level", "y"}, "y": {"y", "level"}, "": set[str]()}[node]
    # what one table could take over from another
    pins = [kf.Pin("CurveAir", (0.4,), 5.8), kf.Pin("CurveGain", (0.4,), 1.04)]
    settings = {"node": "y", "smoothness": {"CurveAir": 0.1, "MapHeat": 0.1, "CurveGain": 0.1}, "pins": pins}
    label = f"surrogate {node}{' AR' if correlated else ''}"
    return Case(label, SURROGATE, data, parameters, "m", channel if node else "", frozenset(nodes), effect, settings)


@dataclass(frozen=True)
class Outcome:
    """What a method found in a case."""

    case: Case
    channel: bool
    place: bool
    false: bool
    seconds: float  # CPU time
    closeness: float = np.nan  # predicted RMSE over the fitted one, less 1

    def __str__(self) -> str:
        case, near = self.case, f", predicted {self.closeness:+.2%}" if np.isfinite(self.closeness) else ""
        title = f"{case.name}, {case.channel or 'nothing'} at {case.effect:g} deviations" if case.channel else case.name
        return f"{title}: channel {self.channel}, place {self.place}, false {self.false}{near}, {self.seconds:.1f} s"


@dataclass(frozen=True)
class Residuals:
    """The channels of a case, and what a fit of the function as it is leaves of the target."""

    names: list[str]
    columns: Float  # Float[samples, channels]
    errors: Float  # Float[samples]

    @classmethod
    def of(cls, case: Case) -> "Residuals":
        """Fit the function and return its residuals."""
        fit = kf.calibrate(case.text, case.data, case.start, case.target, **case.settings)
        names = [name for name in case.data[0] if name not in (case.target, "time")]
        errors = []
        for data in case.data:
            inputs = {name: values for name, values in data.items() if name != case.target}
            errors.append(
                data[case.target] - kf.simulate(case.text, inputs, fit.parameters)[case.settings["node"]].values
            )
        columns = np.concatenate([np.array([data[name] for name in names]).T for data in case.data])
        return cls(names, columns, np.concatenate(errors))


def judge(case: Case) -> Outcome:
    """Let `propose` look for the term of a case."""
    began = time.process_time()
    proposals = kf.propose(case.text, case.data, case.start, case.target, **case.settings)
    seconds = time.process_time() - began
    first = proposals[0] if proposals.proposals else None
    wrong = any(not case.channel or proposal.term.channel != case.channel for proposal in proposals.proposals)
    channel = first is not None and bool(case.channel) and first.term.channel == case.channel
    places = set() if first is None else {first.term.node, *(place.node for place in first.equal_places)}
    close = np.nan
    if first is not None and first.term.kind in ("add", "multiply"):
        close = first.predicted / first.rmse.after - 1
    return Outcome(case, channel, channel and bool(places & case.nodes), wrong, seconds, close)


def by_splines(residuals: Residuals, points: int = 6) -> str:
    """Return the channel that explains most of the residuals by a spline: today's habit."""
    r = residuals.errors
    best, share = "", 0.0
    for name, x in zip(residuals.names, residuals.columns.T, strict=True):
        knots = np.quantile(x, np.linspace(0.01, 0.99, points))
        hats = np.array([np.interp(x, knots, row) for row in np.eye(points)]).T
        rest = r - hats @ np.linalg.lstsq(hats, r, rcond=None)[0]
        explained = 1 - rest @ rest / (r @ r)
        if explained > share:
            best, share = name, explained
    # F test at 1 % over all channels
    from scipy.stats import f

    ratio = share / points / ((1 - share) / (r.size - points))
    return best if f.sf(ratio, points, r.size - points) * len(residuals.names) < 0.01 else ""


def by_boosting(residuals: Residuals) -> str:
    """Return the most important channel of a boosted fit to the residuals, if it explains held-out ones."""
    from sklearn.ensemble import HistGradientBoostingRegressor
    from sklearn.inspection import permutation_importance

    X, r = residuals.columns, residuals.errors
    cut = int(0.7 * r.size)
    model = HistGradientBoostingRegressor(max_iter=100, random_state=0).fit(X[:cut], r[:cut])
    if model.score(X[cut:], r[cut:]) <= 0:
        return ""
    importance = permutation_importance(model, X[cut:], r[cut:], n_repeats=2, random_state=0)
    return residuals.names[int(np.argmax(importance.importances_mean))]


SPLINES = "spline of the residuals, by channel"
BOOSTING = "boosting of the residuals, scikit-learn"
PEERS: Mapping[str, tuple[str, Callable[[Residuals], str]]] = {
    SPLINES: ("numpy", by_splines),
    BOOSTING: ("sklearn", by_boosting),
}


def judge_peers(case: Case) -> dict[str, Outcome]:
    """Let the peers that are installed look for the channel of a case; their time is without that of the fit."""
    residuals = Residuals.of(case)
    outcomes = {}
    for name, (package, method) in PEERS.items():
        if not installed(package):
            continue
        began = time.process_time()
        channel = method(residuals)
        seconds = time.process_time() - began
        right = bool(channel) and channel == case.channel
        outcomes[name] = Outcome(case, right, False, bool(channel) and not right, seconds)
    return outcomes


def run() -> list[Table]:
    """Run all planted cases with every method."""
    outcomes: dict[str, list[Outcome]] = {}
    for case in cases(seed=1):  # those of seed 0 were looked at when the tests of significance were made
        for name, outcome in ({KENNFELD: judge(case)} | judge_peers(case)).items():
            outcomes.setdefault(name, []).append(outcome)
            print(f"{name}: {outcome}", file=sys.stderr, flush=True)
    return [tabulate(outcomes)]


KENNFELD = "kennfeld propose"


def tabulate(outcomes: Mapping[str, Sequence[Outcome]]) -> Table:
    """Return the table of the outcomes of each method."""
    own = outcomes[KENNFELD]
    planted = [o for o in own if o.case.channel]
    effects = [f"channel, {effect:g} deviations" for effect in EFFECTS]
    columns = ("method", *effects, "place", "false, with a term", "false, without", "CPU time per case")
    table = Table(f"missing: {len(own)} cases, {len(planted)} of them with a missing term", columns)
    for name, rows in outcomes.items():
        _add(table, name, rows)
    for name in PEERS:
        if name not in outcomes:
            table.add(name, "not installed")
    correlated = [o for o in own if " AR" in o.case.name]
    right = sum(o.place for o in correlated if o.case.channel)
    false, absent = sum(o.false for o in correlated), sum(bool(o.case.channel) for o in correlated)
    close = np.array([o.closeness for o in own if np.isfinite(o.closeness)])
    table.notes = [
        f"With errors of a correlation of {CORRELATION:g} from sample to sample: {right} of {absent} places, "
        f"{false} of {len(correlated)} false.",
        f"Predicted RMSE of curves over the fitted one: {close.min():+.2%} to {close.max():+.2%}.",
        "The time of the peers is without that of the fit.",
    ]
    return table


def _add(table: Table, name: str, rows: Sequence[Outcome]) -> None:
    planted, absent = [o for o in rows if o.case.channel], [o for o in rows if not o.case.channel]
    by_effect = [[o.channel for o in planted if o.case.effect == effect] for effect in EFFECTS]
    places = sum(o.place for o in planted)
    table.add(
        name,
        *(f"{sum(own)} of {len(own)}" for own in by_effect),
        f"{places} of {len(planted)}" if places else "never",
        f"{sum(o.false for o in planted)} of {len(planted)}",
        f"{sum(o.false for o in absent)} of {len(absent)}",
        f"{np.mean([o.seconds for o in rows]):.2g} s",
    )
