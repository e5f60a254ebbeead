"""The example of `examples/simulink`: its drawing, its true values, and its recordings, computed without the drawing.

    python tests/importers/simulink/exhaust_drawing.py examples/simulink

writes the files again.
"""

import sys
from pathlib import Path

import numpy as np

from tests.importers.simulink.simulink_files import Model

STEP = 0.2  # s
SAMPLES = 1800
NOISE = 2.0  # degC
SPEEDS = np.array([800.0, 1600.0, 2400.0, 3200.0, 4400.0])
LOADS = np.array([15.0, 35.0, 60.0, 90.0])
TRUE = {"TauSensor": 6.0, "KRetard": 4.5, "Gas/Cooling:Gain": -1.8}
MAP = 180 + 0.09 * SPEEDS[:, None] + 5.2 * LOADS - 0.018 * LOADS**2 + 2e-4 * SPEEDS[:, None] * LOADS

SCRIPT = """% Values of exhaust.mdl as they came with the model
NAxis = [800 1600 2400 3200 4400];   % rpm
LoadAxis = [15 35 60 90];            % %
MapGas = 500 * ones(5, 4);           % degC
KRetard = 3.0;                       % degC per degree of late ignition
TauSensor = 12.0;                    % s
"""
CORRECTION = """function dT = correction(ignition, KRetard)
% Gas is hotter where the ignition is later than 10 degrees
late = max(10 - ignition, 0);
dT = KRetard * late;
end
"""


def exhaust():
    """Gas temperature by a map, a MATLAB Function and a gain; then a sensor with a lag and an S-function."""
    drawn = Model("exhaust", solver="ode3", step=str(STEP))
    units = {"Speed": "rpm", "Load": "%", "Ignition": "deg", "Vehicle": "m/s"}
    for name, unit in units.items():
        drawn.inport(name, Unit=unit)
    _gas(drawn.subsystem("Gas"), units)
    _sensor(drawn.subsystem("Sensor"))
    for at, name in enumerate(units, 1):
        drawn.line(name, f"Gas:{at}")
    drawn.outport("T_sensor", Unit="degC")
    drawn.chain("Gas", "Sensor", "T_sensor")
    return drawn


def _gas(inner, names):
    for name in names:
        inner.inport(name)
    inner.block("Lookup_n-D", "MapGas", ports=(2, 1), Table="MapGas", ExtrapMethod="Clip", InterpMethod="Linear",
                BreakpointsForDimension1="NAxis", BreakpointsForDimension2="LoadAxis",
                NumberOfTableDimensions="2")  # fmt: skip
    inner.function("Correction", CORRECTION, ("ignition",), ("dT",), {"KRetard": "PARAMETER_DATA"})
    inner.block("Gain", "Cooling", Gain="-1")
    inner.block("Sum", "Sum", ports=(3, 1), Inputs="+++")
    inner.outport("T_gas")
    inner.line("Speed", "MapGas:1")
    inner.line("Load", "MapGas:2")
    inner.chain("Ignition", "Correction")
    inner.chain("Vehicle", "Cooling")
    for at, name in enumerate(("MapGas", "Correction", "Cooling"), 1):
        inner.line(name, f"Sum:{at}")
    inner.line("Sum", "T_gas", name="T_gas")


def _sensor(inner):
    inner.inport("T_gas")
    inner.block("Sum", "Sum", ports=(3, 1), Inputs="+--")
    inner.block("Gain", "Rate", Gain="1/TauSensor")
    inner.block("Integrator", "Element", InitialCondition="20")
    inner.block("S-Function", "Radiation", ports=(1, 1), FunctionName="sfun_radiation")
    inner.outport("T_sensor")
    inner.line("T_gas", "Sum:1")
    inner.line("Radiation", "Sum:2")
    inner.line("Element", "Sum:3", "T_sensor", "Radiation")
    inner.chain("Sum", "Rate", "Element")


def levels(random, low, high, shortest, longest):
    """A signal that stays at a level for some seconds, with slopes of 2 s between them."""
    values = np.empty(0)
    while values.size < SAMPLES:
        values = np.append(values, np.full(int(random.uniform(shortest, longest) / STEP), random.uniform(low, high)))
    return np.convolve(np.pad(values[:SAMPLES], 5, "edge"), np.full(11, 1 / 11), "valid")


def drive(seed):
    """A recording: the columns by name, the temperature with noise."""
    random = np.random.default_rng(seed)
    channels = {
        "n_mot": levels(random, 800, 4400, 8, 25),
        "rl": levels(random, 15, 90, 5, 20),
        "zw": levels(random, -5, 25, 5, 15),
        "v_fzg": levels(random, 0, 40, 20, 60),
        "t_wand": levels(random, 60, 240, 40, 90),
    }
    channels = {name: values.round(1) for name, values in channels.items()}
    return channels | {"t_abg": (temperature(channels) + random.normal(0, NOISE, SAMPLES)).round(1)}


KEPT = np.exp(-STEP / TRUE["TauSensor"])  # the share of a difference that is left after a step


def temperature(drive, kept=KEPT):
    """The true temperature of the sensor: the exact answer of a lag whose input is held over a step."""
    gas = bilinear(drive["n_mot"], drive["rl"])
    gas += TRUE["KRetard"] * np.maximum(10 - drive["zw"], 0) + TRUE["Gas/Cooling:Gain"] * drive["v_fzg"]
    gas -= 0.15 * (drive["t_wand"] - 20)
    temperatures, now = np.empty(SAMPLES), 20.0
    for at in range(SAMPLES):
        temperatures[at] = now
        now = gas[at] + (now - gas[at]) * kept
    return temperatures


def bilinear(speed, load):
    """The true map between its points."""
    rows = np.array([np.interp(load, LOADS, row) for row in MAP])
    place = np.interp(speed, SPEEDS, np.arange(len(SPEEDS)))
    low = np.minimum(place.astype(int), len(SPEEDS) - 2)
    samples = np.arange(len(speed))
    return rows[low, samples] + (place - low) * (rows[low + 1, samples] - rows[low, samples])


def write(folder):
    """The model, its script and three drives."""
    exhaust().write(folder, "mdl")
    (folder / "exhaust.m").write_text(SCRIPT, encoding="utf-8")
    for number in (1, 2, 3):
        columns = {"time": (STEP * np.arange(SAMPLES)).round(1)} | drive(number)
        lines = [",".join(columns), "s,rpm,%,deg,m/s,degC,degC"]
        lines += [",".join(f"{value:g}" for value in row) for row in zip(*columns.values(), strict=True)]
        (folder / f"drive_{number}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
