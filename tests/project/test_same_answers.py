"""Each task of `docs/python.md`, by a project and by Python: the same numbers to the last bit."""

from dataclasses import dataclass, field

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.rbf import RBF, Expansion
from tests.guests import marked

TIME = 0.1 * np.arange(60)
STEPS = np.where(np.arange(60) % 20 < 8, 1.0, 3.0) + 0.1 * np.sin(np.arange(60))
LAG = "input u\nscalar k\ny[V] = PT1(k * u, 0.5, 0)"


@dataclass
class Task:
    """What is added to the project, and the arguments by which Python says the same."""

    section: str = ""
    arguments: dict = field(default_factory=dict)
    options: dict = field(default_factory=dict)
    gain: str = ""  # keys of [parameters.Gain]
    dataset: str = ""  # keys of [[dataset]]
    criterion: str = ""  # keys of [[criterion]]


def criteria(**settings):
    return {"target": None, "node": None, "criteria": [kf.Criterion("Predict", "Torque", **settings)]}


TASKS = {
    "a plain fit": Task(),
    "smoothness": Task(gain="smoothness = 10", arguments={"smoothness": {"Gain": 10}}),
    "automatic smoothness": Task(gain='smoothness = "auto"', arguments={"smoothness": {"Gain": "auto"}}),
    "bounds": Task(gain="bounds = [0, 2.5]", arguments={"bounds": {"Gain": (0, 2.5)}}),
    "a pin": Task(gain="pin = [{ at = [1500], value = 1.4 }]", arguments={"pins": [kf.Pin("Gain", (1500,), 1.4)]}),
    "a shape": Task(
        gain="gradient = { x = [0, 0.0008] }",
        arguments={"constraints": [kf.Shape("Gain", 0, "slope", lower=0.0, upper=0.0008)]},
    ),
    "a limit of an output": Task(
        section='[[limit]]\nnode = "Predict"\nmax = 30.0', arguments={"limits": [kf.Limit("Predict", upper=30.0)]}
    ),
    "free breakpoints": Task(
        gain='x = { input = "Speed", breakpoints = [1000, 1900, 3000], free = true }',
        arguments={"free_axes": ["Gain.x"], "start": "moved"},
    ),
    "fixed parameters": Task(gain="free = false", arguments={"free": ["offset"]}),
    "a robust loss": Task(criterion='loss = "huber"\ndelta = 0.1', arguments=criteria(loss="huber", delta=0.1)),
    "weights of samples": Task(
        criterion='weight_channel = "trust"\nregions = [{ where = "Load > 11", weight = 3.0 }]',
        arguments=criteria(weight_channel="trust", regions=[kf.Region("Load > 11", 3.0)]),
    ),
    "test data": Task(section='[[dataset]]\nfiles = ["fresh.csv"]\nuse = "test"', arguments={"test": ["fresh.csv"]}),
    "a delay of points": Task(dataset="shift = { Torque = -1 }", arguments={"shift": {"Torque": -1}}),
    "a sequence": Task(
        section='[[step]]\ngrid_reduction = 2\nmax_iterations = 20\n[[step]]\nname = "fine"',
        options={"steps": [kf.Step(grid_reduction=2, max_iterations=20), kf.Step(name="fine")]},
    ),
    "several starts": Task(
        gain="bounds = [0, 9]\n[parameters.offset]\nbounds = [-9, 9]\n[optimizer]\nstarts = 2\nseed = 3",
        arguments={"bounds": {"Gain": (0, 9), "offset": (-9, 9)}},
        options={"starts": 2, "seed": 3},
    ),
    "a search without gradients": Task(
        gain='bounds = [0, 9]\n[parameters.offset]\nbounds = [-9, 9]\n[optimizer]\nmethod = "global"\nseed = 1\n'
        "max_evaluations = 60",
        arguments={"bounds": {"Gain": (0, 9), "offset": (-9, 9)}},
        options={"method": "global", "seed": 1, "max_evaluations": 60},
    ),
}

LONG = ("a limit of an output", "a search without gradients", "automatic smoothness", "several starts")


def prepared(shop, task):
    """Write the project of a task; return it with the arguments of Python."""
    speed = (1000, 1500, 2000, 2500, 3000, 1200, 1700, 2200)
    noise = 0.1 * np.cos(np.arange(8.0))
    shop.bench("bench.csv", speed)
    torque = kf.read(shop.folder / "bench.csv")["Torque"].values
    # in another unit than the function, and with noise
    columns = {"n [rpm]": None, "n [rad/s]": np.array(speed) * np.pi / 30, "trust": 1 + np.arange(8.0) / 8}
    shop.bench("bench.csv", speed, **columns, **{"Torque [Nm]": torque + noise})
    shop.bench("fresh.csv", (1100, 1600, 2100))
    shop.change('files = ["bench.csv"]', f'files = ["bench.csv"]\n{task.dataset}')
    shop.add(task.criterion or "#").add(f"[parameters.Gain]\n{task.gain}").add(task.section or "#")
    arguments = {"target": "Torque", "node": "Predict", "channels": {"Speed": "n"}, **task.arguments}
    start = kf.read_parameters(shop.folder / "start.json")
    if arguments.pop("start", None):
        gain = start["Gain"]
        start = start.with_parameters(
            kf.Curve("Gain", kf.Axis([1000, 1900, 3000], input="Speed", unit="rpm"), gain.values)
        )
    arguments["test"] = [kf.read(shop.folder / name) for name in arguments.get("test", ())]
    return start, arguments


def numbers(result):
    """All numbers of a result, to be compared bit by bit."""
    values = {name: parameter.values.tolist() for name, parameter in result.parameters.items()}
    axes = {name: [a.breakpoints.tolist() for a in p.axes] for name, p in result.parameters.items()}
    trust = result.trust
    deviation = {name: array.tolist() for name, array in trust.deviation.items()}
    quality = [{key: repr(each) for key, each in vars(row).items()} for row in result.quality]
    factors = {name: dict(each) for name, each in result.smoothness.items()}
    shifts = {name: dict(each) for name, each in result.shifts.items()}
    effort = result.status, result.iterations, result.evaluations, result.cost_before, result.cost_after
    noise = {name: repr(each) for name, each in trust.noise.items()}
    return values, axes, repr(deviation), quality, factors, shifts, effort, noise, dict(trust.persistence)


def assert_same(project, model, data, start, arguments, options=None):
    problem, settings = project.problem(), kf.Options(**options or {})
    expected = project.calibrate(workers=1)
    result = kf.calibrate(model, data, start, options=kf.Options(**options or {}, workers=1), **arguments)
    assert numbers(result) == numbers(expected)
    one = data[0] if isinstance(data, list) else data
    nodes = kf.simulate(model, one, result.parameters, arguments.get("channels"))
    assert [repr(nodes[name].values.tolist()) for name in nodes] == [
        repr(project.simulate(expected.parameters)[0][name].values.tolist()) for name in nodes
    ]
    return problem, settings


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in TASKS]
)
def test_a_task_has_the_same_answer_by_project_and_by_python(name, shop):
    task = TASKS[name]
    start, arguments = prepared(shop, task)
    assert shop.errors() == []
    data = kf.read(shop.folder / "bench.csv")
    assert_same(shop.project, shop.text, data, start, arguments, task.options)


def test_a_frame_has_the_same_answer(shop):
    pytest.importorskip("pandas")
    start, arguments = prepared(shop, TASKS["a plain fit"])
    frame = kf.read(shop.folder / "bench.csv").to_frame()
    # the name of the dataset is part of the result
    assert_same(shop.project, shop.text, kf.Dataset.of("bench", frame), start, arguments)


def test_a_cross_validation_is_the_same(shop):
    start, arguments = prepared(shop, TASKS["smoothness"])
    by_project = kf.cross_validate(shop.project.problem(), folds=3)
    by_python = kf.cross_validate(shop.text, kf.read(shop.folder / "bench.csv"), start, **arguments, folds=3)
    assert by_python.folds == by_project.folds


def test_residuals_are_the_same(shop):
    start, arguments = prepared(shop, TASKS["a plain fit"])
    expected = shop.project.calibrate()
    data = kf.read(shop.folder / "bench.csv")
    result = kf.calibrate(shop.text, data, start, **arguments)
    [own] = kf.residuals(result.inspection.problem, result.parameters, trust=result.trust)
    [other] = kf.residuals(shop.project.problem(), expected.parameters, trust=expected.trust)
    assert own.errors[0].absolute.tolist() == other.errors[0].absolute.tolist()


def lag(shop, **columns):
    """Write a project with memory over a recording in time, with two pieces of it."""
    shop.text = LAG
    shop.toml = shop.toml.replace('[channels]\nSpeed = "n"\n', "").replace('"Predict"', '"y"')
    shop.toml = shop.toml.replace('"Torque"', '"z"')
    shop.csv("bench.csv", {"time [s]": TIME, "u": STEPS, **columns})
    shop.values("start.json", kf.Scalar("k", 1.0))


def response(gain=2.0):
    data = kf.Dataset.of("d", {"u": STEPS}, time=TIME)
    return kf.simulate(LAG, data, {"k": gain})["y"].values + 0.01 * np.cos(7 * np.arange(60))


@pytest.mark.parametrize("form", ["read", "dict", "frame"])
def test_a_function_with_memory_has_the_same_answer(form, shop):
    lag(shop, **{"z [mV]": 1000 * response()})
    read = kf.read(shop.folder / "bench.csv")
    columns = {"time": read.time, "u": STEPS, "z": read["z"].values}
    data = read
    if form == "dict":
        data = kf.Dataset.of("bench", columns, units={"z": "mV"})
    elif form == "frame":
        pytest.importorskip("pandas")
        data = kf.Dataset.of("bench", read.to_frame())
    assert_same(shop.project, LAG, data, {"k": 1.0}, {"target": "z"})


@pytest.mark.parametrize("shift", [0.2, "auto"])
def test_a_delay_in_time_has_the_same_answer(shop, shift):
    lag(shop, z=np.roll(response(), 2))
    text = f'"{shift}"' if shift == "auto" else shift
    shop.change('files = ["bench.csv"]', f'files = ["bench.csv"]\nshift = {{ z = {text} }}')
    data = kf.read(shop.folder / "bench.csv")
    expected, result = shop.project.calibrate(), kf.calibrate(LAG, data, {"k": 1.0}, "z", shift={"z": shift})
    assert numbers(result) == numbers(expected)


def test_points_held_until_a_function_has_settled_have_the_same_answer(shop):
    shop.text = LAG
    shop.toml = shop.toml.replace('[channels]\nSpeed = "n"\n', "").replace('"Predict"', '"y"').replace("Torque", "z")
    shop.change('files = ["bench.csv"]', 'files = ["bench.csv"]\nsettle = 5.0\naverage = 1.0\nstep = 0.1')
    shop.csv("bench.csv", {"u": [1.0, 2.0, 3.0], "z": [2.0, 4.1, 6.0]})
    shop.values("start.json", kf.Scalar("k", 1.0))
    settling = kf.Settling(5.0, average=1.0, step=0.1)
    data = kf.Dataset.of("bench", {"u": [1.0, 2.0, 3.0], "z": [2.0, 4.1, 6.0]}, settling=settling)
    assert_same(shop.project, LAG, data, {"k": 1.0}, {"target": "z"})


@pytest.mark.slow
def test_an_expansion_has_the_same_answer(shop):
    bells = Expansion(0.0, [0.01], [5.0], [[2500.0]], [[800.0]])
    shop.text = "input Speed[rpm]\nPredict[Nm] = Bump(Speed)"
    start = kf.ParameterSet([RBF("Bump", bells, inputs=["Speed"], unit="Nm")])
    start.save(shop.folder / "start.json")
    data = kf.read(shop.folder / "bench.csv")
    arguments = {"target": "Torque", "channels": {"Speed": "n"}}
    assert_same(shop.project, shop.text, data, kf.read_parameters(shop.folder / "start.json"), arguments)


@pytest.mark.slow
@pytest.mark.parametrize("name", marked(["onnx"]))
def test_a_called_network_has_the_same_answer(name, shop):
    pytest.importorskip("onnx")
    from tests.importers.onnx.networks import perceptron, random_layers

    perceptron(shop.folder / "knock.onnx", random_layers([2, 4, 1]))
    shop.text = "input Speed\ninput Load\nscalar k\nPredict = k * net(Speed / 1000, Load / 10)"
    shop.add('[functions]\nnet = "knock.onnx"')
    shop.values("start.json", kf.Scalar("k", 1.0))
    model = kf.formula(shop.text, functions={"net": shop.folder / "knock.onnx"})
    data = kf.read(shop.folder / "bench.csv")
    arguments = {"target": "Torque", "channels": {"Speed": "n"}}
    assert_same(shop.project, model, data, {"k": 1.0}, arguments)
