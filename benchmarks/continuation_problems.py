"""Problems for topic `continuation`: chained lookups, whose cost is full of kinks, each with held-out data."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kennfeld.domain.axis import Axis
from kennfeld.domain.constraints import Pin
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Parameter
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.search.starts import draw_start
from kennfeld.project.demo import petrol_engine, torque

__all__ = ["DATA", "Case", "cases", "missing"]

Float = NDArray[np.float64]
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"  # recordings of real engines, not part of the project
STEADY = DATA / "engine_steady" / "engine1_normalized.xlsx"
TRANSIENT = DATA / "engine_transient"
TORQUE_PIN = Pin(*torque.PIN)

CHAINS: Mapping[str, tuple[str, int]] = {  # formula and number of breakpoints along a map's axis
    "curve behind a map": ("d = Inner(u, v) - w\ny = Outer(d)", 8),
    "curve behind a map, large": ("d = Inner(u, v) - w\ny = Outer(d)", 18),
    "product behind a map": ("d = Inner(u, v) - w\ny = Size(u, v) * Outer(d)", 8),
    "product behind a map, large": ("d = Inner(u, v) - w\ny = Size(u, v) * Outer(d)", 14),
    "curve behind a curve behind a map": ("d = Inner(u, v) - w\ne = Middle(d) + 0.5 * u\ny = Outer(e)", 8),
    "map behind two curves": ("a = First(u) + 0.3 * w\nb = Second(v) - 0.3 * w\ny = Surface(a, b)", 10),
}
STEADY_TARGETS = ("temperature_exhaust_manifold", "NOx", "specific_fuel_consumption", "HC")
TRANSIENT_MODELS = {
    "T_exh_manifold, static": "d = Best(speed, load) - ignition\ny = Size(speed, load) + Eta(d)",
    "T_exh_manifold, with a lag": "d = Best(speed, load) - ignition\ny = PT1(Size(speed, load) + Eta(d), Lag)",
}


@dataclass(frozen=True)
class Case:
    """A problem with test data, made when it is needed."""

    group: str
    name: str
    make: Callable[[], Problem]


def missing() -> str:
    """Return why cases are left out, empty if none are."""
    there = STEADY.is_file() and TRANSIENT.is_dir()
    return "" if there else "The cases of real engines are skipped: their recordings are not at ../shared/data."


def cases(draws: int = 3) -> list[Case]:
    """Return all cases for which there are data, with `draws` of each kind."""
    listed = []
    for draw in range(draws):
        listed += [
            Case("torque", f"noise {n} Nm, draw {draw}", partial(torque_bench, draw, n)) for n in (0.6, 1.8, 5.4)
        ]
        listed.append(Case("load bench", f"draw {draw}", partial(load_bench, draw)))
        listed.append(Case("load bench", f"rough, draw {draw}", partial(load_bench, draw, 0.01)))
        listed += [Case("chain", f"{name}, draw {draw}", partial(chain, name, draw)) for name in CHAINS]
        listed.append(Case("bootstrap", f"torque, draw {draw}", partial(bootstrap, partial(torque_bench, 0), draw)))
        listed.append(Case("bootstrap", f"load bench, draw {draw}", partial(bootstrap, partial(load_bench, 0), draw)))
        if not missing():
            listed += [Case("steady engine", f"{t}, draw {draw}", partial(steady, t, draw)) for t in STEADY_TARGETS]
            listed.append(Case("bootstrap", f"NOx, draw {draw}", partial(bootstrap, partial(steady, "NOx", 0), draw)))
    if not missing():
        listed += [Case("transient engine", name, partial(transient, name)) for name in TRANSIENT_MODELS]
    return listed


def torque_bench(draw: int, noise: float = torque.NOISE) -> Problem:
    """Return the torque demo, 519 values and 2812 points, with other noise."""
    data = torque.bench(draw + 10)
    rng = np.random.default_rng(draw)
    clean = petrol_engine.torque(*(data[name].values for name in ("Speed", "Rel_Airmass", "Ignition")))
    noisy = {name: data[name].values for name in ("Speed", "Rel_Airmass", "Ignition")}
    noisy["Torque"] = clean + noise * rng.standard_normal(clean.size)
    return _torque_problem(noisy, torque.fresh(), torque.start(), torque.SMOOTHNESS)


def load_bench(draw: int, softness: float = 1.0) -> Problem:
    """Return 2110 points of ignition loops on a test bench, for 252 values of a function that is too simple.

    Each loop varies the ignition around the best one at some load. The engine differs from the function by some Nm, and
    smoothness is light, so that kinks matter.
    """
    rng = np.random.default_rng([draw, 1])
    data, test = (_ignition_loops(np.random.default_rng([draw, part]), count) for part, count in ((2, 2110), (3, 800)))
    waves = rng.normal(0.0, 1.0, (8, 3)) * np.array([3.0, 3.0, 2.0]), rng.uniform(0, 2 * np.pi, 8)
    for columns in (data, test):
        scaled = np.stack([columns["Speed"] / 6000, columns["Rel_Airmass"] / 100, columns["Ignition"] / 40])
        columns["Torque"] += 1.5 * np.cos(2 * waves[0] @ scaled + waves[1][:, None]).sum(axis=0)
    eta = Axis(np.linspace(-15.0, 60.0, 11), input="deltaSpark")
    start = ParameterSet(
        [
            _level("MapOptTorque", (12, 10), 82.5),
            _level("MapOptIgnition", (9, 8), 20.0),
            Curve("CurveEtaDeltaSpark", eta, 1.0 - 0.0002 * eta.breakpoints**2),
            _level("MapDragTorque", (7, 7), 20.0),
        ]
    )
    light = {"MapOptTorque": 1.0, "MapOptIgnition": 0.1, "CurveEtaDeltaSpark": 100.0, "MapDragTorque": 1.0}
    factors = {name: softness * factor for name, factor in light.items()}
    return _torque_problem(data, test, start, factors)


def _ignition_loops(rng: np.random.Generator, count: int) -> dict[str, Float]:
    loops = -(-count // 10)
    speed, air = (np.repeat(rng.uniform(*span, loops), 10)[:count] for span in (torque.SPEED, torque.AIR))
    retard = np.tile(np.linspace(-8.0, 30.0, 10), loops)[:count]
    best = petrol_engine.best_spark(speed, air)
    ignition = np.clip(best - retard + rng.normal(0.0, 1.0, count), -5.0, 55.0)
    measured = petrol_engine.torque(speed, air, ignition) + rng.normal(0.0, 1.5, count)
    return {"Speed": speed, "Rel_Airmass": air, "Ignition": ignition, "Torque": measured}


def _level(name: str, shape: tuple[int, int], value: float) -> Map:
    x, y = np.linspace(*torque.SPEED, shape[0]), np.linspace(*torque.AIR, shape[1])
    return Map(name, x, y, np.full(shape, value))


def _torque_problem(
    data: Mapping[str, Float], test: Dataset | Mapping[str, Float], start: ParameterSet, factors: Mapping[str, float]
) -> Problem:
    return ProblemSetup(
        torque.FORMULA,
        data,
        start,
        "Torque",
        node="TorquePredict",
        test=test,
        smoothness=dict(factors),
        pins=[TORQUE_PIN],
    ).problem()


def chain(name: str, draw: int) -> Problem:
    """Return a chain of lookups whose true tables are smooth and drawn at random, plus what no table can represent."""
    text, count = CHAINS[name]
    rng = np.random.default_rng([draw, 5])
    truth = ParameterSet(_random_tables(text, 3 * count, rng))
    samples = int(rng.choice([600, 2000, 6000]))
    training, test = (_chain_data(text, truth, n, rng) for n in (samples, 2000))
    start = []
    for table in _random_tables(text, count, rng):
        sloped = isinstance(table, Curve)
        start.append(table.with_values(0.5 * table.axes[0].breakpoints if sloped else np.full(table.values.shape, 0.1)))
    return ProblemSetup(text, training, ParameterSet(start), "measured", node="y", test=test, smoothness=1e-3).problem()


def _random_tables(text: str, count: int, rng: np.random.Generator) -> list[Parameter]:
    """Return tables of smooth random functions; curves of `count` breakpoints over [-2, 2], maps over [0, 1]."""
    names = [n for n in ("Inner", "Size", "Outer", "Middle", "First", "Second", "Surface") if f"{n}(" in text]
    tables: list[Parameter] = []
    for name in names:
        if name in ("Outer", "Middle"):
            x = np.linspace(-2.0, 2.0, count)
            phase, tilt = rng.uniform(-0.5, 0.5, 2)
            tables.append(Curve(name, x, np.cos(1.5 * x + phase) + tilt * x))
        elif name in ("First", "Second"):
            x = np.linspace(0.0, 1.0, count)
            tables.append(Curve(name, x, x + 0.3 * np.sin(5 * x + rng.uniform(0, 6))))
        else:
            side = np.linspace(-0.5, 1.5, count) if name == "Surface" else np.linspace(0.0, 1.0, count)
            a, b, c, d = rng.uniform(0.5, 1.5, 4)
            surface = a * np.sin(2 * b * side)[:, None] + c * np.cos(3 * d * side)[None, :] + np.outer(side, side)
            tables.append(Map(name, side, side, surface if name != "Size" else 3 + surface))
    return tables


def _chain_data(text: str, truth: ParameterSet, samples: int, rng: np.random.Generator) -> dict[str, Float]:
    from kennfeld.optimize.api import simulate

    columns = {"u": rng.random(samples), "v": rng.random(samples), "w": rng.uniform(-1.0, 1.0, samples)}
    y = simulate(text, columns, truth)["y"].values
    misfit = 0.05 * np.std(y) * np.sin(9 * columns["u"] * columns["w"] + 7 * columns["v"])
    return columns | {"measured": y + misfit + 0.05 * np.std(y) * rng.standard_normal(samples)}


def steady(target: str, draw: int) -> Problem:
    """Return a chain of two maps and a curve on four fifths of 795 steady points of a real engine."""
    from kennfeld import read

    data = read(f"{STEADY}#data")
    order = np.random.default_rng(draw).permutation(data.samples)
    fitted, test = np.split(order, [int(0.8 * order.size)])
    text = "d = Best(engine_speed, engine_load) - intake_valve_opening\ny = Size(engine_speed, engine_load) * Eta(d)"
    maps = _engine_maps(data, ("engine_speed", "engine_load"), 9, 1.0)
    smoothness = {"Best": 0.1, "Size": 0.1, "Eta": 0.1}
    return ProblemSetup(
        text, data.select(fitted), ParameterSet(maps), target, node="y", test=data.select(test), smoothness=smoothness
    ).problem()


def transient(name: str) -> Problem:
    """Return a chain on a recording of a real engine of 22 minutes, scored on another one."""
    from kennfeld import read

    text = TRANSIENT_MODELS[name]
    training, test = (read(str(TRANSIENT / f"gengine1_{part}.csv.gz")) for part in ("m10", "m12"))
    parameters: list[Parameter] = _engine_maps(training, ("speed", "load"), 9, 0.0)
    smoothness = {"Best": 1.0, "Size": 1.0, "Eta": 1.0}
    if "Lag" in text:
        from kennfeld.domain.parameters import Scalar

        parameters.append(Scalar("Lag", 10.0, lower=0.1, upper=500.0))
    return ProblemSetup(
        text, training, ParameterSet(parameters), "T_exh_manifold", node="y", test=test, smoothness=smoothness
    ).problem()


def _engine_maps(data: Dataset, inputs: tuple[str, str], count: int, level: float) -> list[Parameter]:
    x, y = (np.unique(np.quantile(data[name].values, np.linspace(0, 1, count)).round(3)) for name in inputs)
    shape = (x.size, y.size)
    eta = np.linspace(-3.0, 3.0, 13)
    return [
        Map("Best", x, y, np.zeros(shape)),
        Map("Size", x, y, np.full(shape, level)),
        Curve("Eta", eta, 1.0 - 0.05 * eta**2),
    ]


def bootstrap(make: Callable[[], Problem], draw: int) -> Problem:
    """Return a problem with its rows drawn again with replacement, from another start."""
    problem = make()
    training = problem.datasets[0]
    rows = np.random.default_rng([draw, 9]).integers(0, training.samples, training.samples)
    drawn = draw_start(problem, 2 + draw, seed=0, spread=0.2)
    changed = [problem.parameters[name].with_values(values) for name, values in drawn.items()]
    datasets = (training.select(rows), *problem.datasets[1:])
    return replace(problem, datasets=datasets, parameters=problem.parameters.with_parameters(*changed))
