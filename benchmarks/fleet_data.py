"""Recordings of a fleet for topic `fleet`: drives with an exhaust thermometer among channels that no project needs."""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.exhaust_data import AIR, FUEL, NOISE, SPEED, drive, filtered, lag_of, surface

__all__ = ["FORMATS", "USED", "write_fleet"]

Float = NDArray[np.float64]
STEP = 0.1  # s
USED = 4  # channels that the project reads
FURTHER = 8  # channels that it does not read

PROJECT = """\
[model]
file = "exhaust.kf"

[[dataset]]
name = "fleet"
files = ["drive_*{ending}"]
warmup = 10.0

[calibration]
output = ["dcm"]

[parameters.MapTemperature]
x = {{ begin = {SPEED[0]}, end = {SPEED[1]}, count = 12 }}
y = {{ begin = {FUEL[0]}, end = {FUEL[1]}, count = 12 }}
unit = "degC"
initial = 350.0
bounds = [0, 1200]
smoothness = 1e-3

[parameters.Lag]
x = {{ begin = {AIR[0]}, end = {AIR[1]}, count = 10 }}
unit = "s"
initial = 10.0
bounds = [0.05, 60.0]
smoothness = 1e-3

[[criterion]]
node = "T"
target = {{ channel = "Temperature" }}
"""
FORMULA = """\
input Speed[rpm]
input Fuel[mg/stk]
input Air[kg/h]
T[degC] = PT1(MapTemperature(Speed, Fuel), Lag(Air))
"""
UNITS = {"Speed": "rpm", "Fuel": "mg/stk", "Air": "kg/h", "Temperature": "degC"}
# resolution of the channels that a logger stores as whole numbers
RESOLUTION = {"Speed": 0.25, "Temperature": 0.1}


def write_fleet(folder: Path, kind: str, files: int, samples: int) -> Path:
    """Write a project with its recordings, and return the project file."""
    folder.mkdir(parents=True)
    ending, write = FORMATS[kind]
    for number in range(files):
        write(folder / f"drive_{number:03d}{ending}", *record(samples, number))
    (folder / "exhaust.kf").write_text(FORMULA)
    project = folder / "kennfeld.toml"
    project.write_text(PROJECT.format(ending=ending, SPEED=SPEED, FUEL=FUEL, AIR=AIR))
    return project


def record(samples: int, seed: int) -> tuple[Float, Mapping[str, Float]]:
    """Return time stamps and channels of one drive, with the resolution that a logger has."""
    random = np.random.default_rng(seed)
    time = np.arange(samples) * STEP
    speed, fuel = drive(random, time, SPEED), drive(random, time, FUEL)
    air = AIR[0] + (AIR[1] - AIR[0]) * (speed / SPEED[1]) * (0.35 + 0.65 * fuel / FUEL[1])
    temperature = filtered(surface(speed, fuel), lag_of(air, 0), STEP) + random.normal(0.0, NOISE, samples)
    channels = {"Speed": speed, "Fuel": fuel, "Air": air, "Temperature": temperature}
    channels |= {f"further{i}": np.cumsum(random.normal(size=samples)) for i in range(FURTHER)}
    for name, resolution in RESOLUTION.items():
        channels[name] = np.round(channels[name] / resolution) * resolution
    return time, channels


def _write_mdf(path: Path, time: Float, channels: Mapping[str, Float], compression: int) -> None:
    """One group as loggers write it: 16-bit numbers with a conversion, 32-bit floating-point numbers."""
    from asammdf import MDF, Signal

    warnings.simplefilter("ignore")
    signals = []
    for name, values in channels.items():
        step = RESOLUTION.get(name)
        raw = values.astype("<f4") if step is None else np.round(values / step).astype("<u2")
        conversion = None if step is None else {"a": step, "b": 0.0}
        unit = UNITS.get(name, "-")
        signals.append(Signal(raw, time, name=name, unit=unit, conversion=conversion, encoding="utf-8"))
    with MDF(version="4.10") as mdf:
        mdf.append(signals, comment="10 Hz")
        mdf.save(path, overwrite=True, compression=compression)


def _write_table(path: Path, time: Float, channels: Mapping[str, Float]) -> None:
    """The used channels and time with 3 to 7 significant digits, as an export has them."""
    import pyarrow as pa

    table = pa.table(
        {f"{name} [{UNITS.get(name, '-')}]": values.astype(np.float32) for name, values in channels.items()}
    ).add_column(0, "time [s]", pa.array(np.round(time, 1)))
    if path.suffix == ".csv":
        from pyarrow import csv

        csv.write_csv(table.select(range(USED + 1)), path)
    else:
        from pyarrow import parquet

        parquet.write_table(table, path)


# the ending, and the writer of a file
FORMATS: Mapping[str, tuple[str, Callable[[Path, Float, Mapping[str, Float]], None]]] = {
    "MF4": (".mf4", lambda *record: _write_mdf(*record, compression=0)),
    "MF4, zipped": (".mf4", lambda *record: _write_mdf(*record, compression=2)),
    "Parquet": (".parquet", _write_table),
    "CSV": (".csv", _write_table),
}
