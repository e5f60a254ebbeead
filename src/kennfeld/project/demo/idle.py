"""The idle speed governor of the paper: its gains are fitted with an engine model trained on recordings."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.calfiles import read as read_parameters
from kennfeld.domain.dataset import Channel, Dataset, Use
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.project.demo.petrol_engine import random_steps, simulate_engine
from kennfeld.project.schemas import TRAINING_SCHEMA, schema_text

STEP = 0.02  # s, the raster of the governor and of the recordings
NOISE = 2.0  # rpm, of the speed sensor in the recordings
THROTTLE, LOAD = (7.0, 15.0), (15.0, 28.0)  # degrees, Nm
REST = 8.9  # degrees, the throttle from which the governor starts
SET_VALUES = (1980.0, 2800.0, 2400.0, 3000.0, 2200.0)  # rpm, 6 s each
LOADS = (25.0, 22.0, 24.0, 20.0, 26.0)  # Nm, with them
PROJECTS = (("kennfeld.toml", "results"), ("limited.toml", "results-limited"))

FORMULA = """\
# A PI governor that acts each 20 ms, around an engine that is a data-driven model: engine.json, see engine.toml.
input n_set[rpm]
input load[Nm]
output n
scalar Kp[deg/rpm]
scalar Ki[deg/rpm]
step 0.02

n[rpm] = engine(throttle, load, 1980)
miss[rpm] = n_set - n
held[deg] = integrator(Ki * miss / dt, 8.9, 7, 15)
throttle[deg] = clip(Kp * miss + held, 7, 15)

# how far the speed passes a new set value
up = n_set > prev(n_set, n_set)
down = n_set < prev(n_set, n_set)
direction = if(up, 1, if(down, -1, prev(direction, 0)))
overshoot[rpm] = direction * (n - n_set)
"""


def recording(name: str, minutes: float, seed: int, use: Use = "training") -> Dataset:
    """Simulate an engine on a bench: throttle and load change in random steps, the speed is recorded with noise."""
    rng, samples = np.random.default_rng(seed), round(60 * minutes / STEP)
    throttle, load = random_steps(rng, samples, THROTTLE, 10, 100), random_steps(rng, samples, LOAD, 50, 300)
    # rounded before the simulation: the recording has exactly the inputs that the engine had
    throttle, load = throttle.round(2), load.round(1)
    speed = simulate_engine(throttle, load, STEP) + rng.normal(0.0, NOISE, samples)
    channels = (
        Channel("throttle", throttle, "deg"),
        Channel("load", load, "Nm"),
        Channel("speed", speed.round(1), "rpm"),
    )
    return Dataset(name, channels, time=_time(samples), use=use)


def set_values() -> Dataset:
    """Return the set values of the speed; the load changes with them."""
    each = round(6.0 / STEP)
    wanted, load = np.repeat(SET_VALUES, each), np.repeat(LOADS, each)
    return Dataset(
        "set_values", (Channel("n_set", wanted, "rpm"), Channel("load", load, "Nm")), time=_time(wanted.size)
    )


def _time(samples: int) -> Float:
    return np.asarray((STEP * np.arange(samples)).round(2), dtype=np.float64)


def start() -> ParameterSet:
    """Return the initial gains, 0."""
    return ParameterSet(
        [
            Scalar("Kp", 0.0, unit="deg/rpm", description="proportional gain"),
            Scalar("Ki", 0.0, unit="deg/rpm", description="integral gain, each 20 ms"),
        ]
    )


def _text(file: str) -> Callable[[], str]:
    return lambda: Path(__file__).with_name(file).read_text(encoding="utf-8")


FILES = {
    "limited.toml": _text("idle_limited.toml"),
    "engine.toml": _text("idle_engine.toml"),
    TRAINING_SCHEMA: lambda: schema_text(TRAINING_SCHEMA),
    "idle.kf": lambda: FORMULA,
    "start.dcm": start,
    "set_values.csv": set_values,
    "recording.csv": lambda: recording("recording", 3.0, 1),
    "other_recording.csv": lambda: recording("other_recording", 1.5, 2, "test"),
}


def prepare(folder: Path, report: Callable[[str], None]) -> None:
    """Train the engine on its recordings, unless that is done already."""
    target = folder / "engine.json"
    if target.exists():
        return
    from kennfeld.project.surrogate_training import read_training
    from kennfeld.surrogate.surrogate_file import write_surrogate

    report("An engine model from recordings (kennfeld surrogate train engine.toml):")
    surrogate = read_training(folder / "engine.toml").train()
    write_surrogate(surrogate, target)
    report("\n".join(f"  {line}" for line in surrogate.quality))
    report("")


def closing(folder: Path) -> list[list[str]]:
    """Return the quality of the gains on the physical engine, which no calibration has used."""
    rows = [["on the physical engine", "Kp", "Ki", "RMSE, rpm", "overshoot, rpm"]]
    for name, (_, results) in zip(("kennfeld.toml", "limited.toml"), PROJECTS, strict=True):
        parameters = read_parameters(folder / results / "parameters.json")
        kp, ki = (float(parameters[gain].values) for gain in ("Kp", "Ki"))
        miss, over = on_the_engine(kp, ki)
        rows.append([name, f"{kp:.4f}", f"{ki:.5f}", f"{np.sqrt(np.mean(miss**2)):.1f}", f"{over.max():.1f}"])
    return rows


def on_the_engine(kp: float, ki: float) -> tuple[Float, Float]:
    """Return control error and overshoot on the physical engine in rpm, both Float[samples]."""
    data = set_values()
    wanted, held = data["n_set"].values, REST

    def governor(k: int, speed: float) -> float:
        nonlocal held
        miss = wanted[k] - speed
        # the integrator acts with the value before this step, as in the formula text
        angle = min(max(kp * miss + held, THROTTLE[0]), THROTTLE[1])
        held = min(max(held + ki * miss, THROTTLE[0]), THROTTLE[1])
        return float(angle)

    miss = wanted - simulate_engine(governor, data["load"].values, STEP)
    changes = np.sign(np.diff(wanted, prepend=wanted[0]))
    # sample of the latest change of the set value
    last = np.maximum.accumulate(np.where(changes != 0, np.arange(wanted.size), 0))
    return miss, -changes[last] * miss
