"""Calibrates two water tanks on a public benchmark: python tanks.py dataBenchmark.csv.

The file is that of M. Schoukens, P. Mattsson, T. Wigren, J.-P. Noel: Cascaded tanks benchmark combining soft and hard
nonlinearities, 2016 (nonlinearbenchmark.org). Its columns are uEst, uVal, yEst, yVal and Ts; the initial levels are
unknown, and the same for both halves.
"""

import sys
from pathlib import Path

import kennfeld as kf

STEP = 4.0  # s
# start, lower and upper bound
VALUES = {
    "pump": (0.04, 0.001, 0.5),
    "drain1": (0.05, 0.0001, 0.5),
    "drain2": (0.05, 0.001, 0.5),
    "power1": (0.5, 0.2, 1.5),
    "power2": (0.5, 0.2, 1.0),
    "into2": (1.0, 0.1, 5.0),
    "spilt": (0.3, 0.0, 2.0),
    "head2": (0.0, -2.0, 2.0),
    "pipe": (1.0, 0.0, 60.0),
    "start1": (5.0, 0.0, 10.0),
    "start2": (5.0, 0.0, 12.0),
    "top2": (10.0, 8.0, 14.0),
}


def calibrated(file: Path) -> kf.Result:
    """The tanks fitted to the first half of the benchmark, scored on the second."""
    data = kf.read(file)
    count = data.samples
    halves = [
        kf.Dataset.of(
            half, {"u": data[f"u{half}"].values, "y": data[f"y{half}"].values}, time=[STEP * i for i in range(count)]
        )
        for half in ("Est", "Val")
    ]
    start = kf.ParameterSet(
        [kf.Scalar(name, value, lower=low, upper=high) for name, (value, low, high) in VALUES.items()]
    )
    model = kf.formula(Path(__file__).with_name("tanks.kf").read_text(encoding="utf-8"), parameters=list(start))
    return kf.calibrate(model, halves[0], start, target="y", test=halves[1], options=kf.Options(max_iterations=500))


if __name__ == "__main__":
    result = calibrated(Path(sys.argv[1]))
    print(result)
    for name, parameter in result.parameters.items():
        print(f"{name:8s} {float(parameter.values):9.4f}")
