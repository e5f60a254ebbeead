"""The files of topic `files`, made anew from a seed."""

from pathlib import Path

import numpy as np

__all__ = ["CHANNELS", "write_calibration", "write_csv", "write_mdf"]

# name of a group: seconds between samples, channels, whether they are whole numbers with a conversion
GROUPS = {"fast": (0.001, 3, True), "medium": (0.01, 60, False), "slow": (0.1, 200, False)}
LASTING = 3600  # s
CHANNELS = (*(f"fast{i}" for i in range(3)), *(f"medium{i}" for i in range(10)), *(f"slow{i}" for i in range(7)))


def write_calibration(path: Path) -> None:
    """5000 maps of 16 x 16, in the format that the ending says."""
    from kennfeld.calfiles import write
    from kennfeld.domain.axis import Axis
    from kennfeld.domain.parameter_set import ParameterSet
    from kennfeld.domain.parameters import Map

    random = np.random.default_rng(0)
    speed = Axis(600 + 400.0 * np.arange(16), unit="rpm")
    load = Axis(10 + 6.0 * np.arange(16), unit="%")
    maps = (
        Map(f"Map_{i:04d}", speed, load, 100 * random.normal(size=(16, 16)), unit="Nm", description="a map")
        for i in range(5000)
    )
    write(ParameterSet(maps), path)


def write_mdf(path: Path, compressed: bool) -> None:
    """An hour of three rasters: 1 ms whole numbers with a conversion, 10 ms and 100 ms floating-point numbers."""
    import warnings

    from asammdf import MDF, Signal

    warnings.simplefilter("ignore")
    random = np.random.default_rng(1)
    with MDF(version="4.10") as mdf:
        for name, (step, count, whole) in GROUPS.items():
            time = np.arange(round(LASTING / step)) * step
            signals = []
            for i in range(count):
                walk = np.cumsum(random.normal(size=time.size)) * np.sqrt(step)
                raw = np.clip(np.round(100 * walk), -32768, 32767).astype("<i2") if whole else walk.astype("<f4")
                conversion = {"a": 0.01, "b": 0.0} if whole else None
                signals.append(Signal(raw, time, name=f"{name}{i}", unit="-", conversion=conversion, encoding="utf-8"))
            mdf.append(signals, comment=name)
        mdf.save(path, overwrite=True, compression=2 if compressed else 0)


def write_csv(path: Path, rows: int = 1_000_000, columns: int = 20) -> None:
    """Time and floating-point numbers with six digits after the point."""
    import pyarrow as pa
    from pyarrow import csv

    random = np.random.default_rng(2)
    columns_by_name = {"time": np.round(0.01 * np.arange(rows), 2)}
    columns_by_name |= {f"channel{i}": np.round(100 * random.normal(size=rows), 6) for i in range(columns - 1)}
    csv.write_csv(pa.table(columns_by_name), path)
