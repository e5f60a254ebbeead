"""Projects with several recordings, for tests of partitions."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.project import Project

STEADY = """
[model]
file = "torque.kf"

[[dataset]]
name = "bench"
files = ["bench_*.csv"]

[[dataset]]
name = "road"
files = ["road.csv"]
use = "test"

[parameters.M]
x = { input = "n", count = 6 }
y = { input = "rl", count = 5 }
initial = 100.0
smoothness = 0.01
lock = "no-data"

[parameters.C]
x = { input = "zw", count = 4 }
initial = 1.0
smoothness = 0.01

[[criterion]]
node = "TorqueModel"
target = { channel = "torque" }
"""

FEW = STEADY.replace("count = 6", "count = 3").replace("count = 5", "count = 2")  # values, for few samples
OFF = '\n[optimizer]\ncontinuation = "off"\n'

TIMED = """
[model]
file = "lag.kf"

[[dataset]]
name = "drives"
files = ["drive_*.csv"]
warmup = 1.0
where = "u > 0.05"

[parameters.K]
x = { input = "u", begin = 0, end = 1, count = 5 }
initial = 1.0
smoothness = 1e-4

[parameters.T]
initial = 1.0
bounds = [0.05, 10]

[[criterion]]
node = "Lagged"
target = { channel = "y" }
loss = "huber"
delta = 2.0
scale = 0.05
"""

SHIFTED = """
[model]
file = "model.kf"

[[dataset]]
name = "drives"
files = ["drive_*.csv"]
shift = { y = "auto" }

[[dataset]]
name = "road"
files = ["road.csv"]
use = "test"
shift = { y = "auto" }

[parameters.K]
x = { input = "u", begin = 0, end = 1, count = 5 }
initial = 1.0
smoothness = 1e-4

[[criterion]]
node = "Y"
target = { channel = "y" }
"""

MODELS = {
    "memory": ("input u\nY = PT1(K(u), T)\n", "\n[parameters.T]\ninitial = 1.0\nbounds = [0.05, 10]\n"),
    "none": ("input u\nY = K(u)\n", ""),
}


def write_steady(folder: Path, files: int = 2, samples: int = 400, text: str = STEADY) -> Path:
    """Write steady-state points in files of different lengths; the coordinate of `C` depends on a free parameter.

    With 700 samples, two descents end 0.3 % apart, the limit from which a third is tried: that depends on rounding.
    """
    random = np.random.default_rng(1)
    (folder / "torque.kf").write_text(
        "input n[rpm]\ninput rl[%]\ninput zw\nTorqueModel = M(n, rl) * C(zw + 0.01*M(n, rl))\n"
    )
    for number in range(files + 1):
        n, rl, zw = random.uniform(size=(3, samples + 90 * number)) * [[4000], [90], [10]] + [[800], [10], [0]]
        torque = (0.01 * n + 2 * rl) * (1 - 0.002 * (zw - 5) ** 2) + random.normal(0, 1, n.size)
        torque[::17] = np.nan
        name = f"bench_{number}.csv" if number < files else "road.csv"
        rows = (",".join(f"{x:.8g}" for x in row).replace("nan", "") for row in zip(n, rl, zw, torque, strict=True))
        (folder / name).write_text("\n".join(["n,rl,zw,torque", *rows]))
    (folder / "kennfeld.toml").write_text(text)
    return folder / "kennfeld.toml"


def write_timed(folder: Path, files: int = 3, samples: int = 400, text: str = TIMED, growth: int = 50) -> Path:
    """Write recordings of a lag behind a curve."""
    random = np.random.default_rng(2)
    (folder / "lag.kf").write_text("input u\nLagged = PT1(K(u), T)\n")
    for number in range(files):
        count = samples + growth * number
        u = np.clip(np.cumsum(random.normal(0, 0.05, count)) % 1.0, 0, 1)
        y = np.zeros(count)
        for k in range(1, count):
            y[k] = y[k - 1] + 0.1 / (0.7 + 0.1) * (3 * u[k] ** 2 - y[k - 1])
        y += random.normal(0, 0.02, count)
        rows = (f"{0.1 * k:.1f},{u[k]:.8g},{y[k]:.8g}" for k in range(count))
        (folder / f"drive_{number}.csv").write_text("\n".join(["time,u,y", *rows]))
    (folder / "kennfeld.toml").write_text(text)
    return folder / "kennfeld.toml"


def write_uneven(folder: Path, samples: int = 300) -> Path:
    """Write recordings with steps of 0.4 and 0.02 s, of an integrator in a loop."""
    path = write_timed(folder, samples=samples)
    (folder / "lag.kf").write_text("input u\nLagged = integrator((K(u) - Lagged) / T, 0)\n")
    for number in range(3):
        name = folder / f"drive_{number}.csv"
        head, *rows = name.read_text().split("\n")
        times = np.concatenate([[0.0], np.cumsum(np.resize([0.4, 0.02], len(rows) - 1))])
        rows = [f"{time:.2f},{row.partition(',')[2]}" for time, row in zip(times, rows, strict=True)]
        name.write_text("\n".join([head, *rows]))
    return path


def write_shifted(
    folder: Path,
    model: str = "memory",
    delay: float = 3.4,
    text: str = SHIFTED,
    files: int = 4,
    samples: int = 820,
) -> Path:
    """Write recordings whose channel `y` is some samples late; each is of another length."""
    random = np.random.default_rng(3)
    formula, parameter = MODELS[model]
    (folder / "model.kf").write_text(formula)
    for number in range(files + 1):
        count = samples + 90 * number
        u = 0.5 + 0.45 * np.sin(np.cumsum(random.normal(0, 0.2, count)))
        y = 3 * u**2
        if model == "memory":
            y = lagged(y, 0.7)
        y = np.interp(np.arange(count) - delay, np.arange(count), y) + random.normal(0, 0.02, count)
        name = f"drive_{number}.csv" if number < files else "road.csv"
        rows = (f"{0.1 * k:.1f},{u[k]:.8g},{y[k]:.8g}" for k in range(20, count))
        (folder / name).write_text("\n".join(["time,u,y", *rows]))
    (folder / "kennfeld.toml").write_text(text + parameter)
    return folder / "kennfeld.toml"


def write_lasting(folder: Path, text: str, files: int = 4, samples: int = 1500) -> Path:
    """Write recordings of a curve whose errors last for seconds."""
    random = np.random.default_rng(4)
    (folder / "model.kf").write_text("input u\nY = K(u)\n")
    for number in range(files):
        count = samples + 200 * number
        u = 0.5 + 0.45 * np.sin(np.cumsum(random.normal(0, 0.15, count)))
        y = 3 * u**2 + lagged(random.normal(0, 2.0, count), 3.0)
        rows = (f"{0.1 * k:.1f},{u[k]:.8g},{y[k]:.8g}" for k in range(count))
        (folder / f"drive_{number}.csv").write_text("\n".join(["time,u,y", *rows]))
    (folder / "kennfeld.toml").write_text(text)
    return folder / "kennfeld.toml"


def lagged(inputs: np.ndarray, seconds: float) -> np.ndarray:
    """Return the output of a lag, sampled every 0.1 s."""
    output = inputs.copy()
    for k in range(1, inputs.size):
        output[k] = output[k - 1] + 0.1 / (seconds + 0.1) * (inputs[k] - output[k - 1])
    return output


def in_partitions(path: Path, size: int, **cluster: object) -> Project:
    """Read a project whose data are evaluated in partitions of this size."""
    project = Project.read(path)
    return replace(
        project, file=replace(project.file, cluster=replace(project.file.cluster, partition=size, **cluster))
    )
